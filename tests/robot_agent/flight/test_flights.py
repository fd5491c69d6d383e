"""Flights keep what they flew, however they end, and leave the robot trusted where it is well."""

from __future__ import annotations

import numpy as np
import pytest
from learned_things import experience, layout
from robots_that_learn import LIMITS, LaggedRobot, double_integrator

from nufleet.robot_agent.flight.equipment import learner_for
from nufleet.robot_agent.flight.flights import performance_of
from nufleet.robot_agent.flight.memory import Memory, MemoryFolderError
from nufleet.robot_agent.flight.online_gp import Correction
from nufleet.robot_agent.flight.tracking import Learner, Watch
from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import Played, perform
from nufleet.robot_agent.robot import Robot
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.experience.file import digest
from nufleet.shared.paths.references import approach
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.messages import Outcome
from nufleet.shared.wire.motions import (
    Flight,
    RichFlight,
    RichFlightDetails,
    Tracking,
    TrackingDetails,
    Weighted,
)

PATH = travel(np.array([[0.0, 0.0], [0.5, 0.5], [-0.4, 0.2]]), 0.5, 1.0, 0.02)


def flown(
    robot: Robot,
    motion: Flight,
    memory: Memory | None = None,
    *,
    switch: HaltSwitch | None = None,
    realtime: float | None = None,
    watch: Watch = lambda *_: None,
) -> Played:
    switch = HaltSwitch() if switch is None else switch
    performance = performance_of(
        motion,
        robot,
        memory or Memory(None),
        realtime=realtime,
        switch=switch,
        on_played=lambda samples: None,
        watch=watch,
    )
    return perform(robot, performance, switch, on_resting=lambda: None)


def baseline_flight() -> Tracking:
    return Tracking(desired=PATH, inverse="baseline")


@pytest.mark.parametrize("realtime", [None, 1e9])
@pytest.mark.parametrize("outcome", [Outcome.CANCELLED, Outcome.ABORTED])
def test_a_flight_that_is_ended_early_says_who_ended_it_and_keeps_what_it_flew(
    outcome: Outcome, realtime: float | None
) -> None:
    robot, switch = LaggedRobot(), HaltSwitch()

    def watch(sample: int, *_: object) -> None:
        if sample == 40:
            switch.halt(outcome, "that is enough")

    played = flown(robot, baseline_flight(), switch=switch, realtime=realtime, watch=watch)
    assert (played.outcome, played.reason, played.fault) == (outcome, "that is enough", None)
    assert len(played.samples.reference) == len(played.samples.response) == 41
    np.testing.assert_array_equal(played.samples.reference, PATH[:41])
    assert isinstance(played.samples.details, TrackingDetails)
    assert robot.rests >= 1


def test_a_halt_between_the_look_at_the_switch_and_the_sample_counts_as_well() -> None:
    """A paced robot waits for its sample, and that is when most halts come."""
    robot, switch = LaggedRobot(), HaltSwitch()
    settle = len(approach(robot.spec, PATH, LIMITS))
    wait = switch.wait

    def wait_and_halt(timeout_s: float) -> None:
        if robot.samples == settle + 7:
            switch.halt(Outcome.ABORTED, "stopped by somebody")
        wait(0.0)

    switch.wait = wait_and_halt  # type: ignore[method-assign]
    played = flown(robot, baseline_flight(), switch=switch, realtime=1.0)
    assert (played.outcome, played.reason) == (Outcome.ABORTED, "stopped by somebody")
    assert len(played.samples.response) == 7
    assert played.samples.details is not None


def test_a_rich_flight_teaches_the_robot_its_baseline() -> None:
    memory, robot = Memory(None), LaggedRobot(noise_std_m=1e-3)
    played = flown(robot, RichFlight(duration_s=60.0, seed=1), memory)
    assert played.outcome is Outcome.COMPLETED
    assert isinstance(played.samples.details, RichFlightDetails)
    assert set(memory.flown_s) == {"x", "y"}
    # Three samples late: the error of a ramp is its slope times 60 ms.
    model = memory.own_model(robot.spec).model
    assert model is not None
    ramp = np.linspace(0.0, 1.0, 51)
    error = model.axes[0].error(ramp, 0.0)
    assert error[-1] == pytest.approx(3 * (ramp[1] - ramp[0]), rel=0.1)


def test_a_baseline_that_cannot_be_stored_fails_the_flight_and_not_the_robot(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    memory = Memory(None)

    def full(*_: object) -> None:
        raise MemoryFolderError("/disk/own cannot be written: No space left on device")

    monkeypatch.setattr(memory, "learn", full)
    played = flown(LaggedRobot(), RichFlight(duration_s=60.0, seed=1), memory)
    assert (played.outcome, played.fault) == (Outcome.FAILED, None)
    assert "No space left on device" in played.reason


def test_a_flight_that_fails_on_its_way_is_a_failed_one_with_its_samples() -> None:
    way = len(approach(LaggedRobot().spec, PATH, LIMITS))
    robot = LaggedRobot(blind_at=way + 30)
    played = flown(robot, baseline_flight())
    assert played.outcome is Outcome.FAILED
    assert f"not finite at sample {way + 30}" in played.reason
    assert len(played.samples.response) == 30


def test_each_flight_begins_with_a_process_of_its_own() -> None:
    robot, memory = double_integrator(), Memory(None)
    prior = experience()
    memory.keep_prior(prior, digest(prior))
    motion = Tracking(desired=PATH[:, :1], inverse="prior", prior_sha256=digest(prior))
    first, second = (learner_for(motion, robot, memory, None) for _ in range(2))
    assert isinstance(first, Learner)
    assert isinstance(second, Learner)
    assert first.process is not second.process
    assert first.layout == layout()


def test_a_prior_that_is_gone_is_an_error_of_the_robot() -> None:
    motion = Tracking(desired=PATH[:, :1], inverse="prior", prior_sha256="0" * 64)
    with pytest.raises(RobotError, match="no longer has a prior"):
        learner_for(motion, double_integrator(), Memory(None), None)


def mixture_of(memory: Memory, *payloads: bytes, weight: float = 0.3) -> Tracking:
    """A flight with a mixture of experiences, which the memory then holds."""
    for place, payload in enumerate(payloads):
        memory.keep_prior(payload, digest(payload), beside=place > 0)
    mixture = tuple(Weighted(sha256=digest(payload), weight=weight) for payload in payloads)
    return Tracking(desired=PATH, inverse="mixture", mixture=mixture)


def test_a_mixture_flies_under_guard_and_keeps_its_weights_over_time() -> None:
    robot, memory = known_robot()
    fit = {"axes": ("x", "y"), "robot_kind": "lagged"}
    priors = [
        experience(f"source-{h}", layout=layout(sample_time_s=0.02, horizon_samples=h), **fit)
        for h in (5, 8)
    ]
    seen: list[FloatArray] = []

    def watch(
        sample: int,
        desired: FloatArray,
        actual: FloatArray,
        correction: Correction | None,
        share: float,
    ) -> None:
        assert correction is not None
        seen.append(correction.weights)

    found = details(flown(robot, mixture_of(memory, *priors), memory, watch=watch))
    assert found.experts == ("source-5", "source-8")
    assert found.weights is not None
    assert found.weights.shape == (len(PATH), 3)
    np.testing.assert_allclose(found.weights[0], [0.3, 0.3, 0.4])
    np.testing.assert_allclose(found.weights.sum(axis=1), 1.0)
    assert np.abs(found.weights[-1] - found.weights[0]).max() > 0.01
    np.testing.assert_array_equal(found.weights, seen)


def test_a_mixture_in_which_a_slow_source_has_no_say_flies_as_none_does() -> None:
    """What none says is meant for the horizon at which none flies, not for a slow source's."""
    memory = Memory(None)
    slow = experience("slow", layout=layout("state", horizon_samples=47), axes=("x",))
    motion = mixture_of(memory, slow, weight=1e-12)
    changed = {"desired": PATH[:, :1], "guarded": False, "learn": False}
    mixed = flown(double_integrator(), motion.model_copy(update=changed), memory)
    none = Tracking(desired=PATH, inverse="zero-prior", layout=layout("state", horizon_samples=27))
    alone = flown(double_integrator(), none.model_copy(update=changed))
    np.testing.assert_allclose(mixed.samples.response, alone.samples.response, atol=1e-6)


def test_a_mixture_that_is_gone_is_an_error_of_the_robot() -> None:
    motion = mixture_of(Memory(None), experience())
    with pytest.raises(RobotError, match="no longer has a prior of the mixture"):
        learner_for(motion, double_integrator(), Memory(None), None)


def known_robot() -> tuple[LaggedRobot, Memory]:
    """A robot that has flown one path, so that it knows itself."""
    robot, memory = LaggedRobot(noise_std_m=1e-3), Memory(None)
    assert flown(robot, baseline_flight(), memory).outcome is Outcome.COMPLETED
    return robot, memory


def details(played: Played) -> TrackingDetails:
    assert played.outcome is Outcome.COMPLETED, played.reason
    assert isinstance(played.samples.details, TrackingDetails)
    return played.samples.details


def rms(played: Played) -> float:
    away = played.samples.response - details(played).desired
    return float(np.sqrt(np.mean(np.sum(away**2, axis=1))))


OWN = Tracking(desired=PATH, inverse="own")


def test_one_flight_is_enough_to_invert_ones_own_loop_and_to_say_what_is_left() -> None:
    robot, memory = known_robot()
    baseline = flown(robot, baseline_flight(), memory)
    own = flown(robot, OWN, memory)
    assert rms(own) < 0.2 * rms(baseline)
    for played in (baseline, own):
        predicted = details(played).predicted
        assert predicted is not None
        assert 0.9 * predicted.low < rms(played) < 1.1 * predicted.high
    assert details(own).taken_back is None


def test_every_flight_adds_to_what_a_robot_knows_of_itself() -> None:
    robot, memory = known_robot()
    before_s = memory.flown_s["x"]
    flown(robot, OWN, memory)
    assert memory.flown_s["x"] == pytest.approx(before_s + len(PATH) * robot.spec.sample_time_s)


def test_a_robot_that_has_changed_notices_it_by_its_own_prediction() -> None:
    _, memory = known_robot()
    changed = LaggedRobot(delays=(7, 3), noise_std_m=1e-3)
    played = flown(changed, OWN, memory)
    (finding,) = details(played).findings
    assert finding.startswith("axis x:")
    assert "carries something else" in finding
    again = flown(changed, OWN, memory)
    assert rms(again) < 0.5 * rms(played)
    assert details(again).findings == ()


def test_the_guard_takes_a_mixture_back_as_it_does_a_single_prior() -> None:
    robot, memory = known_robot()
    wrong = experience(layout=layout(sample_time_s=0.02), robot_kind="lagged", axes=("x", "y"))
    motion = mixture_of(memory, wrong, weight=0.9)
    kept = memory.prior
    assert kept is not None
    kept.inverse._layers[0][0][:] = -40.0  # asks for far too much of every point ahead
    played = flown(robot, motion.model_copy(update={"learn": False}), memory)
    assert details(played).taken_back is not None
    baseline = flown(robot, baseline_flight(), memory)
    assert rms(played) < 1.1 * rms(baseline)


def test_a_wrong_prior_gives_way_to_the_robots_model_of_itself() -> None:
    robot, memory = known_robot()
    wrong = experience(layout=layout(sample_time_s=0.02), robot_kind="lagged", axes=("x", "y"))
    kept = memory.keep_prior(wrong, digest(wrong))
    kept.inverse._layers[0][0][:] = -40.0  # asks for far too much of every point ahead
    motion = Tracking(desired=PATH, inverse="prior", prior_sha256=digest(wrong), learn=False)
    played = flown(robot, motion, memory)
    event = details(played).taken_back
    assert event is not None
    assert event.given_to == "own"
    fallen = slice(event.sample + 60, None)
    away = (played.samples.response - details(played).desired)[fallen]
    own = (flown(robot, OWN, memory).samples.response - PATH)[fallen]
    assert np.sqrt(np.mean(away**2)) < 1.3 * np.sqrt(np.mean(own**2))
