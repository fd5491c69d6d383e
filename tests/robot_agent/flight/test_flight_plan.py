"""A flight is planned within the robot's limits and memory, or refused with the reason."""

from __future__ import annotations

import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learned_things import experience, flown_before, layout
from pydantic import ValidationError
from robots_that_learn import LIMITS, LaggedRobot, double_integrator

from nufleet.robot_agent.flight.memory import Memory
from nufleet.robot_agent.flight.own_model import evidence_in
from nufleet.robot_agent.flight.plan import plan_flight
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RefusedError
from nufleet.shared.experience.file import digest
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.paths.references import approach, rich_references, step_references
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.motions import (
    AxisPrior,
    Flight,
    FlightPlan,
    RichFlight,
    StepTest,
    Tracking,
    Weighted,
)

ROBOT = double_integrator()
SPEC = ROBOT.spec
STEP_S = SPEC.sample_time_s
PATH = travel(np.array([[0.0], [0.9], [-0.5], [0.0]]), 0.8, 1.5, STEP_S)
PRIOR = experience()


def memory(prior: bytes | None = None, *, baseline: bool = False) -> Memory:
    known = Memory(None)
    if prior is not None:
        known.keep_prior(prior, digest(prior))
    if baseline:
        known.learn(flown_before(SPEC))
    return known


def planned(
    motion: Flight,
    spec: RobotSpec = SPEC,
    known: Memory | None = None,
    *,
    allow_unguarded: bool = True,
) -> FlightPlan:
    return plan_flight(
        motion,
        spec,
        ROBOT.state_names,
        known or memory(),
        "drone-7",
        allow_unguarded=allow_unguarded,
    )


def refused(motion: Flight, spec: RobotSpec = SPEC, known: Memory | None = None) -> tuple[str, str]:
    with pytest.raises(RefusedError) as raised:
        planned(motion, spec, known)
    assert str(raised.value).startswith("drone-7 refused: ")
    return raised.value.code, raised.value.reason


def with_prior(payload: bytes = PRIOR, *, guarded: bool = True) -> Tracking:
    return Tracking(desired=PATH, inverse="prior", prior_sha256=digest(payload), guarded=guarded)


def zero_prior(known: InverseLayout, *, guarded: bool = False) -> Tracking:
    return Tracking(desired=PATH, inverse="zero-prior", layout=known, guarded=guarded)


# What is accepted, and how long it takes.


def test_steps_are_planned_as_long_as_they_are_flown() -> None:
    plan = planned(StepTest(axis="x"))
    assert plan.sample_time_s == STEP_S
    assert plan.samples == len(step_references(SPEC, 0))
    assert plan.duration_s == pytest.approx(plan.samples * STEP_S + SPEC.settling_time_s)


@settings(max_examples=10, deadline=None)
@given(st.floats(1.0, 300.0), st.integers(0, 1000))
def test_a_rich_flight_is_planned_as_long_as_it_is_flown(duration_s: float, seed: int) -> None:
    plan = planned(RichFlight(duration_s=duration_s, seed=seed))
    flown = rich_references(SPEC, duration_s, np.random.default_rng(seed))
    assert plan.samples == len(flown)
    assert duration_s <= plan.duration_s <= duration_s + 30.0


def test_the_way_to_a_start_elsewhere_and_settling_are_counted() -> None:
    elsewhere = PATH + 0.4
    plan = planned(Tracking(desired=elsewhere, inverse="baseline"))
    assert plan.samples == len(PATH)
    way = approach(SPEC, elsewhere, LIMITS)
    assert plan.duration_s == pytest.approx((len(PATH) + len(way)) * STEP_S + SPEC.settling_time_s)
    at_once = planned(Tracking(desired=PATH, inverse="baseline"))
    assert at_once.duration_s < plan.duration_s


def test_a_baseline_needs_neither_prior_nor_model() -> None:
    assert planned(Tracking(desired=PATH, inverse="baseline")).samples == len(PATH)


def test_a_prior_is_flown_under_a_guard_that_knows_the_baseline_or_without_one() -> None:
    assert planned(with_prior(), known=memory(PRIOR, baseline=True)).samples == len(PATH)
    assert planned(with_prior(guarded=False), known=memory(PRIOR)).samples == len(PATH)
    assert planned(zero_prior(layout(), guarded=True), known=memory(baseline=True))


# What is refused.


def test_an_unknown_axis_is_refused_with_those_there_are() -> None:
    assert refused(StepTest(axis="yaw")) == ("unknown-axis", "no axis 'yaw'; there are x")


@pytest.mark.parametrize(
    "motion",
    [
        StepTest(axis="x"),
        RichFlight(duration_s=60.0, seed=0),
        Tracking(desired=PATH, inverse="baseline"),
    ],
)
def test_a_robot_without_tracking_limits_only_takes_frequency_tests(motion: Flight) -> None:
    spec = SPEC.model_copy(update={"tracking": None})
    code, reason = refused(motion, spec)
    assert code == "no-tracking"
    assert "tracking limits" in reason


@pytest.mark.parametrize(
    ("desired", "words"),
    [
        (3 * PATH, "outside the workspace of ±1.5"),
        (PATH[::4], "speed"),
        (PATH[:1], "two different points"),
        (np.zeros_like(PATH), "two different points"),
        (np.where(PATH[9] == PATH, np.nan, PATH), "not finite"),
        (np.repeat(PATH, 2, axis=1), "2 columns, the robot has 1 axes"),
        (PATH[:, :0], "0 columns, the robot has 1 axes"),
        (PATH[:0], "two different points"),
    ],
)
def test_a_path_that_cannot_be_flown_is_refused(desired: FloatArray, words: str) -> None:
    code, reason = refused(Tracking.model_construct(desired=desired, inverse="baseline"))
    assert code == "trajectory"
    assert words in reason


@pytest.mark.parametrize(
    "motion",
    [
        StepTest(axis="x"),
        RichFlight(duration_s=60.0, seed=0),
        Tracking(desired=PATH, inverse="baseline"),
    ],
)
def test_a_flight_longer_than_the_robot_accepts_is_refused(motion: Flight) -> None:
    needed_s = planned(motion).duration_s
    short = SPEC.model_copy(update={"duration_max_s": 0.99 * needed_s})
    code, reason = refused(motion, short)
    assert code == "duration"
    assert f"at most {short.duration_max_s:g} s" in reason
    enough = SPEC.model_copy(update={"duration_max_s": math.nextafter(needed_s, math.inf)})
    assert planned(motion, enough).duration_s == needed_s


def test_a_rich_flight_whose_baseline_could_not_be_learned_is_refused_before_it_is_flown() -> None:
    spec = SPEC.model_copy(update={"sample_time_s": 0.001, "settling_time_s": 120.0})
    code, reason = refused(RichFlight(duration_s=60.0, seed=0), spec)
    assert code == "baseline"
    assert "shorter settling time" in reason


def test_a_flight_with_a_prior_needs_that_prior() -> None:
    code, reason = refused(with_prior())
    assert (code, "nufleet transfer" in reason) == ("no-prior", True)
    other = experience("somebody", seed=5)
    code, reason = refused(with_prior(), known=memory(other, baseline=True))
    assert code == "other-prior"
    assert "from somebody" in reason


def test_an_axis_takes_only_a_prior_that_was_learned_on_it() -> None:
    elsewhere = experience("elsewhere", axes=("y",))
    known = memory(PRIOR)
    known.keep_prior(elsewhere, digest(elsewhere), beside=True)

    def on_x(prior: bytes) -> Tracking:
        own = (AxisPrior(axis="x", sha256=digest(prior)),)
        return with_prior(guarded=False).model_copy(update={"prior_by_axis": own})

    assert planned(on_x(PRIOR), known=known).samples == len(PATH)
    code, reason = refused(on_x(elsewhere), known=known)
    assert code == "misfit"
    assert "the experience of elsewhere was learned on y, not on x" in reason
    assert refused(on_x(experience("gone")), known=known)[0] == "other-prior"


def mixed(*payloads: bytes, weight: float = 0.3) -> Tracking:
    mixture = tuple(Weighted(sha256=digest(payload), weight=weight) for payload in payloads)
    return Tracking(desired=PATH, inverse="mixture", mixture=mixture, guarded=False)


def test_a_mixture_flies_with_priors_of_one_architecture_that_the_robot_holds() -> None:
    longer = experience("longer", layout=layout(horizon_samples=30))
    known = memory(PRIOR)
    code, reason = refused(mixed(PRIOR, longer), known=known)
    assert (code, "from source; transfer it again" in reason) == ("other-prior", True)
    known.keep_prior(longer, digest(longer), beside=True)
    assert planned(mixed(PRIOR, longer), known=known).samples == len(PATH)
    # Each of them can also fly alone.
    assert planned(with_prior(longer, guarded=False), known=known).samples == len(PATH)
    state = experience("feedback", "state")
    known.keep_prior(state, digest(state), beside=True)
    code, reason = refused(mixed(PRIOR, state), known=known)
    assert code == "misfit"
    assert "choose sources of one architecture" in reason


def test_a_mixture_is_guarded_as_a_single_prior_is() -> None:
    with pytest.raises(RefusedError, match="allow_unguarded = true"):
        planned(mixed(PRIOR), known=memory(PRIOR), allow_unguarded=False)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"mixture": ()}, "experiences with weights belong"),
        ({"inverse": "baseline"}, "experiences with weights belong"),
        ({"mixture": 2 * (Weighted(sha256=digest(PRIOR), weight=0.3),)}, "in the mixture twice"),
        (
            {
                "mixture": tuple(
                    Weighted(sha256=digest(PRIOR)[:-1] + end, weight=0.5) for end in "ab"
                )
            },
            "leave nothing to flying without experience",
        ),
    ],
)
def test_a_request_for_a_mixture_that_means_nothing_is_none(
    changed: dict[str, object], words: str
) -> None:
    fields = mixed(PRIOR).model_dump(exclude={"desired", "mixture"})
    fields |= {"desired": PATH, "mixture": (Weighted(sha256=digest(PRIOR), weight=0.3),)} | changed
    with pytest.raises(ValidationError, match=words):
        Tracking.model_validate(fields)


def test_a_flight_without_a_guard_is_a_setting_of_the_robot() -> None:
    for motion in (with_prior(guarded=False), zero_prior(layout(), guarded=False)):
        with pytest.raises(RefusedError, match="allow_unguarded = true") as raised:
            planned(motion, known=memory(PRIOR, baseline=True), allow_unguarded=False)
        assert raised.value.code == "unguarded"
        assert planned(motion, known=memory(PRIOR)).samples == len(PATH)
    alone = Tracking(desired=PATH, inverse="baseline", guarded=False)
    assert planned(alone, allow_unguarded=False).samples == len(PATH)


def test_a_guarded_flight_needs_a_known_baseline() -> None:
    for motion in (with_prior(), zero_prior(layout(), guarded=True)):
        code, reason = refused(motion, known=memory(PRIOR))
        assert code == "no-baseline"
        assert "no model of its baseline" in reason
        assert "rich flight" in reason


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"sample_time_s": 0.02}, "sample time is 0.015 s, the robot's 0.02 s"),
        ({"kind": "quadrotor"}, "learned on a double-integrator"),
        (
            {"axes": (SPEC.axes[0].model_copy(update={"name": "z"}),)},
            "the robot has no axis 'x'",
        ),
    ],
)
def test_a_prior_that_does_not_fit_the_robot_any_more_is_not_flown(
    changed: dict[str, object], words: str
) -> None:
    spec = SPEC.model_copy(update=changed)
    path = travel(np.array([[0.0], [0.9], [-0.5], [0.0]]), 0.8, 1.5, spec.sample_time_s)
    motion = with_prior(guarded=False).model_copy(update={"desired": path})
    code, reason = refused(motion, spec, memory(PRIOR))
    assert code == "misfit"
    assert words in reason
    assert "transfer a different one" in reason


@pytest.mark.parametrize(
    ("known", "words"),
    [
        (layout(sample_time_s=0.02), "sample time of 0.02 s, the robot one of 0.015 s"),
        (layout("state", states=("position", "tilt")), "the robot measures position, velocity"),
        (layout("state", states=("velocity",)), "the robot measures position, velocity"),
    ],
)
def test_a_layout_for_another_robot_is_refused(known: InverseLayout, words: str) -> None:
    code, reason = refused(zero_prior(known))
    assert code == "layout"
    assert words in reason


def test_a_guard_needs_to_know_one_axis_at_least() -> None:
    robot = LaggedRobot()
    line = np.array([[0.0, 0.0], [0.5, 0.5]])
    desired = travel(line, 0.5, 1.0, robot.spec.sample_time_s)
    known = Memory(None)
    motion = Tracking(
        desired=desired, inverse="zero-prior", layout=layout(sample_time_s=0.02), guarded=True
    )
    with pytest.raises(RefusedError, match="any completed motion") as raised:
        plan_flight(motion, robot.spec, robot.state_names, known, "drone-7")
    assert raised.value.code == "no-baseline"
    known.learn(flown_before(robot.spec, "x"))
    assert plan_flight(motion, robot.spec, robot.state_names, known, "drone-7")


def own_flight() -> Tracking:
    return Tracking(desired=PATH, inverse="own")


def test_a_robot_that_knows_itself_flies_its_own_inverse() -> None:
    assert planned(own_flight(), known=memory(baseline=True)).samples == len(PATH)


def test_a_robot_that_knows_nothing_of_itself_says_what_would_tell_it() -> None:
    code, reason = refused(own_flight())
    assert code == "no-own-model"
    assert "--rich-flight" in reason


def test_a_model_too_vague_for_a_path_is_refused_with_what_is_expected() -> None:
    """A millimetre of motion under a millimetre of noise."""
    noise = 1e-3 * np.random.default_rng(0).standard_normal((200, 1))
    moved = 2e-3 * np.sin(0.5 * np.arange(200))[:, np.newaxis]
    known = memory()
    known.learn(evidence_in(SPEC, moved, moved + noise))
    code, reason = refused(own_flight(), known=known)
    assert code == "vague-own-model"
    assert re.search(r"an error of .* mm RMS is expected, .* mm to .* mm, and its", reason)
