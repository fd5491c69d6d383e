"""Experiences over the network: learned, offered, handed over, flown with, and kept."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from fleet_lab import Lab, Orchestrator, assert_never_moved, double_integrator, refusal, submitted
from puppet_robot import PuppetRobot
from robots_that_learn import LaggedRobot
from tracked_clover import tracked

from nufleet.orchestrator.experience.learning import Lesson, fly_lessons
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.linear_inverse import linear_experience
from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.experience.training import Origin, TrainingData
from nufleet.orchestrator.experience.transfer import transfer
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError, MalformedMessageError, RobotError
from nufleet.shared.experience.file import decode_experience, digest, encode_experience
from nufleet.shared.experience.layout import Architecture, InverseLayout
from nufleet.shared.frequency_test.multitone import multitone
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.messages import GoalRequest, Outcome
from nufleet.shared.wire.motions import Tracking, Way
from nufleet.sims.double_integrator import DoubleIntegrator, DoubleIntegratorSettings

PATH = travel(np.array([[0.0], [0.9], [-0.5], [0.6], [0.0]]), 0.8, 1.5, 0.015)
PREVIEW = InverseLayout(
    architecture="preview", states=("position",), sample_time_s=0.015, horizon_samples=20
)


def experience(
    robot: str = "source",
    *,
    layout: InverseLayout = PREVIEW,
    kind: str = "double-integrator",
    gain: float = 1.0,
) -> bytes:
    """An inverse that previews: γ from the path a little ahead."""
    rng = np.random.default_rng(0)
    inputs = rng.standard_normal((200, len(layout.input_names)))
    data = TrainingData(inputs, gain * inputs[:, -1])
    return encode_experience(linear_experience(data, layout, Origin(robot, kind, ("x",), "m", 1)))


@pytest.fixture
def orchestrator(lab: Lab, tmp_path: Path) -> Orchestrator:
    lab.agent("source", double_integrator(0.85, 1), state_folder=tmp_path / "source")
    lab.agent("target", double_integrator(0.9, 2), state_folder=tmp_path / "target")
    return lab.orchestrator()


@pytest.fixture
def fleet(orchestrator: Orchestrator) -> Fleet:
    return orchestrator.fleet


def test_a_robot_offers_what_was_installed_on_it_and_hands_it_out(fleet: Fleet) -> None:
    assert fleet.describe("source").experiences == ()
    payload = experience()
    assert install(fleet, "source", "experience", payload) == (digest(payload), payload)
    (offer,) = fleet.describe("source").experiences
    assert (offer.sha256, offer.size_bytes) == (digest(payload), len(payload))
    assert offer.manifest == decode_experience(payload).manifest
    assert fleet.fetch("source", offer.sha256) == payload


def test_a_transferred_prior_survives_the_agents_restart(lab: Lab, tmp_path: Path) -> None:
    agent = lab.agent("target", double_integrator(0.9, 2), state_folder=tmp_path / "target")
    lab.agent("source", double_integrator(0.85, 1), state_folder=tmp_path / "source")
    fleet = lab.orchestrator().fleet
    install(fleet, "source", "experience", experience())
    given = transfer(fleet, ExperienceLibrary(fleet), "source", fleet.describe("target"))
    Pilot(fleet, "run").rich("target", duration_s=60.0, seed=0)
    agent.close()
    lab.agent("target", double_integrator(0.9, 2), state_folder=tmp_path / "target")
    again = lab.orchestrator("orchestrator-2").fleet.describe("target")
    assert again.prior is not None
    assert again.prior.sha256 == given.sha256
    assert again.baseline_known


def test_another_robots_experience_is_no_experience_of_ones_own(fleet: Fleet) -> None:
    payload = experience("source")
    assert refusal(lambda: install(fleet, "target", "experience", payload)) == "misfit"


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        (experience(kind="quadrotor"), "learned on a quadrotor"),
        (
            experience(layout=PREVIEW.model_copy(update={"sample_time_s": 0.02})),
            "its sample time is 0.02 s, the robot's 0.015 s",
        ),
    ],
)
def test_what_does_not_fit_the_robot_is_refused_with_the_reason(
    fleet: Fleet, payload: bytes, reason: str
) -> None:
    with pytest.raises(Exception, match=reason):
        fleet.install("target", "prior", payload, digest(payload))
    assert fleet.describe("target").prior is None


@pytest.mark.parametrize("damage", ["truncated", "altered", "another file"])
def test_a_damaged_file_is_refused_and_the_prior_before_it_stays(fleet: Fleet, damage: str) -> None:
    good = experience()
    install(fleet, "target", "prior", good)
    bad = {
        "truncated": good[:-5],
        "altered": good[:-1] + bytes([good[-1] ^ 1]),
        "another file": b"PK\x03\x04" + bytes(1000),
    }[damage]
    sha256 = digest(good if damage != "another file" else bad)
    assert refusal(lambda: fleet.install("target", "prior", bad, sha256)) == "malformed"
    prior = fleet.describe("target").prior
    assert prior is not None
    assert prior.sha256 == digest(good)


def test_a_source_without_experience_cannot_pass_one_on(fleet: Fleet) -> None:
    with pytest.raises(InvalidInputError, match="it offers none; train one with `nufleet train"):
        transfer(fleet, ExperienceLibrary(fleet), "source", fleet.describe("target"))


class BlindRobot(DoubleIntegrator):
    """A robot that measures its output alone."""

    def __init__(self, alpha: float) -> None:
        settings = DoubleIntegratorSettings(alpha=alpha, beta=0.003)
        super().__init__(settings, np.random.default_rng(0))

    @property
    def state_names(self) -> tuple[str, ...]:
        return ()

    def observe(self) -> FloatArray:
        return Robot.observe(self)


@pytest.fixture
def blind(lab: Lab) -> Fleet:
    for name, alpha in (("source", 0.95), ("target", 0.85)):
        lab.agent(name, BlindRobot(alpha))
    return lab.orchestrator().fleet


def lessons(fleet: Fleet, architecture: Architecture) -> Lesson:
    (lesson,) = fly_lessons(
        Pilot(fleet, "lessons"),
        fleet,
        fleet.describe("source"),
        (architecture,),
        seed=0,
        duration_s=60.0,
        say=lambda robot, what: None,
    )
    return lesson


def test_a_robot_that_measures_its_output_alone_learns_and_flies_a_preview(blind: Fleet) -> None:
    lesson = lessons(blind, "preview")
    payload = encode_experience(linear_experience(lesson.data, lesson.choice.layout, lesson.origin))
    install(blind, "source", "experience", payload)
    transfer(blind, ExperienceLibrary(blind), "source", blind.describe("target"))
    Pilot(blind, "rich").rich("target", duration_s=60.0, seed=1)
    errors = flown(blind)
    assert errors["prior"] < 0.5 * errors["baseline"]


def test_a_robot_that_measures_its_output_alone_learns_no_inverse_of_its_state(
    lab: Lab, blind: Fleet
) -> None:
    with pytest.raises(InvalidInputError, match=r"measures its output alone.*architecture preview"):
        lessons(blind, "state")
    assert_never_moved(lab.orchestrator("orchestrator-2"), "source")


def test_a_robot_that_measures_its_output_alone_is_told_what_it_can_fly_with_in_place_of_none(
    lab: Lab, blind: Fleet, tmp_path: Path
) -> None:
    with pytest.raises(InvalidInputError, match=r"--inverse own, or transfer a preview"):
        tracked(lab, tmp_path, "zero-prior")
    assert_never_moved(lab.orchestrator("orchestrator-2"), "target")


def flown(fleet: Fleet, path: FloatArray = PATH) -> dict[str, float]:
    """The errors of one path: baseline, zero prior, the prior that is installed."""
    pilot = Pilot(fleet, "run")
    prior = fleet.describe("target").prior
    assert prior is not None
    flights = [
        pilot.along("target", Way(inverse="baseline"), path, "baseline"),
        pilot.along("target", Way(inverse="zero-prior", layout=PREVIEW), path, "none"),
        pilot.along("target", Way(inverse="prior", prior_sha256=prior.sha256), path, "prior"),
    ]
    assert [flight.failure for flight in flights] == [None] * 3
    return {flight.label: flight.rms_error for flight in flights}


def test_the_targets_own_experience_makes_it_track_better_at_the_first_attempt(
    fleet: Fleet,
) -> None:
    pilot = Pilot(fleet, "lesson")
    result, details = pilot.rich("source", duration_s=60.0, seed=0)
    pilot.rich("target", duration_s=60.0, seed=1)
    inputs, gamma = PREVIEW.pairs(result.reference[:, 0], details.states[:, 0, :1])
    origin = Origin("source", "double-integrator", ("x",), "m", 1)
    learned = linear_experience(TrainingData(inputs, gamma), PREVIEW, origin)
    install(fleet, "source", "experience", encode_experience(learned))
    transfer(fleet, ExperienceLibrary(fleet), "source", fleet.describe("target"))
    errors = flown(fleet)
    assert errors["prior"] < 0.2 * errors["baseline"]


def test_one_test_is_all_that_a_guard_and_a_robots_own_inverse_need(
    orchestrator: Orchestrator,
) -> None:
    """As after a ranking: the first flights, and no flight of minutes before them."""
    fleet = orchestrator.fleet
    (tones,) = multitone(2 * np.pi / 10.0, [(3, 5, 7, 11, 15)], [np.ones(5)])
    assert orchestrator.run("target", "test", tones=tones).outcome is Outcome.COMPLETED
    assert fleet.describe("target").own_flight_s["x"] > 10.0
    pilot = Pilot(fleet, "run")
    sha256 = install(fleet, "target", "prior", experience(gain=-4.0)).sha256
    harmful = pilot.along("target", Way(inverse="prior", prior_sha256=sha256), PATH, "harmful")
    own = pilot.along("target", Way(inverse="own"), PATH, "own")
    baseline = pilot.along("target", Way(inverse="baseline"), PATH, "baseline")
    assert harmful.details.taken_back is not None
    assert harmful.rms_error <= 1.1 * baseline.rms_error
    assert own.rms_error < 0.1 * baseline.rms_error
    predicted = own.details.predicted
    assert predicted is not None
    assert predicted.high < 0.2 * baseline.rms_error


def test_a_robot_that_knows_nothing_of_itself_flies_no_inverse_of_it(fleet: Fleet) -> None:
    pilot = Pilot(fleet, "run")
    assert refusal(lambda: pilot.along("target", Way(inverse="own"), PATH, "own")) == "no-own-model"


def test_a_harmful_prior_is_taken_back_and_the_result_says_when_and_why(fleet: Fleet) -> None:
    sha256 = install(fleet, "target", "prior", experience(gain=-4.0)).sha256
    pilot = Pilot(fleet, "run")
    pilot.rich("target", duration_s=60.0, seed=0)
    baseline = pilot.along("target", Way(inverse="baseline"), PATH, "baseline")
    flight = pilot.along("target", Way(inverse="prior", prior_sha256=sha256), PATH, "prior")
    event = flight.details.taken_back
    assert event is not None
    assert "baseline" in event.reason
    assert flight.details.share[event.sample + 40] == 0.0
    assert flight.rms_error <= 1.1 * baseline.rms_error


def test_a_guarded_flight_needs_a_baseline_that_is_known(fleet: Fleet) -> None:
    install(fleet, "target", "prior", experience())
    pilot = Pilot(fleet, "run")
    way = Way(inverse="prior", prior_sha256=digest(experience()))
    other = Way(inverse="prior", prior_sha256="0" * 64)
    assert refusal(lambda: pilot.along("target", way, PATH, "prior")) == "no-baseline"
    assert refusal(lambda: pilot.along("target", other, PATH, "prior")) == "other-prior"
    fleet.remove_prior("target")
    assert refusal(lambda: pilot.along("target", way, PATH, "prior")) == "no-prior"


@pytest.mark.parametrize(
    ("desired", "reason"),
    [
        (3 * PATH, "outside the workspace"),
        (PATH[::4], "speed"),
        (PATH[:1], "two different points"),
        (np.repeat(PATH, 2, axis=1), "2 columns, the robot has 1 axes"),
    ],
)
def test_a_path_that_the_robot_may_not_fly_is_refused_before_it_moves(
    orchestrator: Orchestrator, desired: FloatArray, reason: str
) -> None:
    pilot = Pilot(orchestrator.fleet, "run")
    with pytest.raises(Exception, match=reason):
        pilot.along("target", Way(inverse="baseline"), desired, "baseline")
    assert_never_moved(orchestrator, "target")


def test_a_robot_without_tracking_limits_takes_tests_only(lab: Lab) -> None:
    lab.agent("puppet", PuppetRobot())
    fleet = lab.orchestrator().fleet
    assert (
        refusal(lambda: Pilot(fleet, "run").rich("puppet", duration_s=60.0, seed=0))
        == "no-tracking"
    )


def test_the_same_path_sent_again_is_the_same_flight(fleet: Fleet, lab: Lab) -> None:
    orchestrator = lab.orchestrator("orchestrator-2")
    request = GoalRequest(
        goal_id="once",
        owner="orchestrator-2",
        motion=Tracking(desired=PATH, inverse="baseline"),
    )
    first = submitted(orchestrator.fleet, "target", request)
    assert orchestrator.fleet.submit("target", request) == first
    other = request.model_copy(update={"motion": Tracking(desired=0.5 * PATH, inverse="baseline")})
    assert refusal(lambda: orchestrator.fleet.submit("target", other)) == "goal-id-reused"
    orchestrator.result("target", "once")


def test_a_prior_is_not_changed_while_the_robot_flies(lab: Lab) -> None:
    # The flight takes minutes, so that it lasts for as long as the messages take.
    lab.agent("slow", double_integrator(0.85, 1), realtime=0.1)
    orchestrator = lab.orchestrator("orchestrator-1")
    request = GoalRequest(
        goal_id="long",
        owner="orchestrator-1",
        motion=Tracking(desired=PATH, inverse="baseline"),
    )
    submitted(orchestrator.fleet, "slow", request)
    assert refusal(lambda: install(orchestrator.fleet, "slow", "prior", experience())) == "busy"
    orchestrator.fleet.stop("slow", "enough")
    result = orchestrator.result("slow", "long")
    assert result.outcome == "aborted"
    assert len(result.reference) < len(PATH)
    assert "enough" in result.reason


def test_what_a_robot_returns_is_checked_against_what_was_asked(fleet: Fleet) -> None:
    with pytest.raises(MalformedMessageError, match="not a frequency test"):
        Pilot(fleet, "run").steps("target", "x").test_plan  # noqa: B018


def test_a_flight_that_fails_says_why(lab: Lab) -> None:
    lab.agent("blind", LaggedRobot(blind_at=7))
    fleet = lab.orchestrator().fleet
    with pytest.raises(RobotError, match="not finite"):
        Pilot(fleet, "run").steps("blind", "x")
