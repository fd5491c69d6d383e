"""The contract is examined statement by statement: our drivers keep it, and breaches are named."""

from __future__ import annotations

import signal
import threading
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from fleet_lab import double_integrator
from puppet_robot import PuppetRobot

from nufleet.robot_agent.driver_kit import check, statements
from nufleet.robot_agent.driver_kit.check import Report, assert_keeps_contract, check_robot
from nufleet.robot_agent.driver_kit.statements import STATEMENTS
from nufleet.robot_agent.robot import Record, Robot, RobotAround
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.robots.health import Health
from nufleet.sims.faulty_robot import FAULTY, FaultyRobotSettings

FIELD = {"delay_s": 0.02, "jitter_s": 0.008, "loss": 0.01, "battery_s": 600.0}


def in_the_field() -> Robot:
    settings = FaultyRobotSettings.model_validate(
        {
            "driver": "double_integrator",
            "settings": {"alpha": 1.0, "beta": 0.003, "noise_std_m": 0.001},
            "field": {**FIELD, "takes_off": True, "switch": True},
        }
    )
    return FAULTY.build({"a": settings}, np.random.default_rng(0))["a"]


@pytest.mark.parametrize("build", [lambda: double_integrator(0.9, 1), in_the_field])
def test_our_drivers_keep_the_contract(build: Any) -> None:
    report = check_robot(build())
    assert not report.failed, str(report)
    assert [one.holds for one in report.examined] == [True] * len(STATEMENTS)


class Follower(RobotAround):
    """A robot that keeps the contract, for breaches to be added one at a time."""

    def __init__(self, **spec: Any) -> None:
        self.inner = double_integrator(0.9, 2)
        super().__init__(self.inner)
        self._spec_changes = spec

    @property
    def spec(self) -> Any:
        return self.inner.spec.model_copy(update=self._spec_changes)


def breach(**overrides: Any) -> Robot:
    return type("Breach", (Follower,), overrides)()


def raises(error: Exception) -> Any:
    def method(self: Any, *_: Any) -> Any:
        raise error

    return method


class Swapped(PuppetRobot):
    def run(self, references: FloatArray) -> FloatArray:
        return super().run(references)[:, ::-1]


class Ahead(Follower):
    def step(self, reference: FloatArray) -> FloatArray:
        return reference


class Offset(Follower):
    def measure_output(self) -> FloatArray:
        return self.inner.measure_output() + 0.7


BREACHES: dict[str, tuple[Any, str, str]] = {
    "an unexpected error": (
        lambda: breach(connect=raises(OSError("no port"))),
        "It connects",
        "the driver raised OSError('no port')",
    ),
    "an offset": (Offset, "It rests at reference 0", "rests at 0.7"),
    "the reference as its measurement": (Ahead, "measured before", "in the sample whose"),
    "a reversed axis": (
        lambda: breach(step=lambda self, r: -self.inner.step(r)),
        "Each axis follows",
        "gives -",
    ),
    "millimetres": (
        lambda: breach(step=lambda self, r: 1e-3 * self.inner.step(r)),
        "Each axis follows",
        "times as much",
    ),
    "another shape": (
        lambda: breach(step=lambda self, r: np.zeros(3)),
        "It stays where it rests",
        "`step` returned",
    ),
    "no sensor": (
        lambda: breach(measure_output=raises(RobotError("no position estimate"))),
        "It rests at reference 0",
        "no position estimate",
    ),
    "an empty battery": (
        lambda: breach(health=lambda self: Health(ready=False, reason="2.9 V")),
        "It reports its health at once",
        "not ready: 2.9 V",
    ),
    "a record of nothing": (
        lambda: breach(record=lambda self: Record(np.zeros(0), np.zeros(0), np.zeros((0, 1)))),
        "Each axis follows",
        "the times of 0 samples",
    ),
    "a rest that stops where it is": (
        lambda: breach(rest=lambda self: None),
        "It comes to rest|A sample|The output",
        "rests at|was at",
    ),
    "a state of another sample": (
        lambda: breach(observe=lambda self: self.inner.observe() + 1.0),
        "The state that it observes",
        "`observe` saw",
    ),
    "a landing that fails": (
        lambda: breach(end=raises(RobotError("no ground"))),
        "It ends, and begins again",
        "no ground",
    ),
    "steps while disconnected": (
        lambda: breach(disconnect=lambda self: None),
        "A second `disconnect`",
        "moved a robot that was disconnected",
    ),
    "a kill that does nothing": (
        lambda: breach(kill=lambda self: None),
        "Its motors can be cut",
        "still moves it",
    ),
}


@pytest.mark.parametrize("name", BREACHES)
def test_a_breach_is_found_with_what_was_observed_and_what_to_mend(name: str) -> None:
    build, statement, observed = BREACHES[name]
    report = check_robot(build())
    assert report.failed, str(report)
    first = report.failed[0]
    assert any(
        first.statement.startswith(one) or one in first.statement for one in statement.split("|")
    )
    assert any(one in first.observed for one in observed.split("|")), first.observed
    assert first.mend
    assert f"FAIL {first.statement}" in str(report)


@pytest.mark.parametrize(("delays_s", "at_once"), [((0.5, 0.0, 0.5), True), ((0.5,) * 3, False)])
def test_only_a_driver_that_always_takes_its_time_reports_its_health_late(
    delays_s: tuple[float, ...], at_once: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    now_s, delays = [0.0], iter(delays_s)
    monkeypatch.setattr(statements, "time", SimpleNamespace(monotonic=lambda: now_s[0]))

    def health(_: Robot) -> Health:
        now_s[0] += next(delays)
        return Health()

    report = check_robot(breach(health=health), moves=False)
    assert [one.observed for one in report.failed] == ([] if at_once else ["it took 0.5 s"])


def test_swapped_axes_are_named() -> None:
    report = check_robot(Swapped())
    assert "reference x moves axis y" in str(report)


def test_a_robot_that_is_not_to_be_moved_is_not() -> None:
    robot = PuppetRobot()
    report = check_robot(robot, moves=False)
    assert (robot.motions, robot.begun, robot.connected) == (0, 0, False)
    skipped = [one for one in report.examined if one.holds is None]
    assert len(skipped) == sum(one.moves for one in STATEMENTS)


def test_the_motors_of_a_real_robot_are_cut_on_request_alone() -> None:
    report = check_robot(Follower(simulated=False))
    (failed,) = report.failed
    assert "samples took" in failed.observed  # it plays faster than its samples last
    assert report.examined[-1].holds is None
    assert "--kill" in report.examined[-1].observed


def test_a_driver_that_hangs_is_named_and_not_asked_for_more(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(check, "STATEMENT_MAX_S", 0.05)
    goes_on = threading.Event()
    robot = breach(connect=lambda self: goes_on.wait(10.0))
    report = check_robot(robot)
    goes_on.set()
    assert "has not returned" in report.failed[0].observed
    assert all(one.holds is None for one in report.examined[2 : len(STATEMENTS)])


def test_a_robot_whose_examination_is_interrupted_comes_to_rest_and_lands() -> None:
    calls = []

    class Interrupted(Follower):
        def begin(self) -> None:
            calls.append("begin")
            self.inner.begin()

        def step(self, reference: FloatArray) -> FloatArray:
            if "step" not in calls:
                calls.append("step")
                main = threading.main_thread().ident
                assert main is not None
                signal.pthread_kill(main, signal.SIGINT)
            return self.inner.step(reference)

        def rest(self) -> None:
            calls.append("rest")
            self.inner.rest()

        def end(self) -> None:
            calls.append("end")
            self.inner.end()

        def disconnect(self) -> None:
            calls.append("disconnect")
            self.inner.disconnect()

    with pytest.raises(KeyboardInterrupt, match=r"^r is at rest$"):
        check_robot(Interrupted(), name="r")
    assert calls[-3:] == ["rest", "end", "disconnect"]


def test_an_interrupted_robot_that_does_not_come_to_rest_is_named() -> None:
    def step(self: Follower, reference: FloatArray) -> FloatArray:
        main = threading.main_thread().ident
        assert main is not None
        signal.pthread_kill(main, signal.SIGINT)
        raise RobotError("the link is gone")

    def rest(self: Follower) -> None:
        raise RobotError("the link is gone")

    with pytest.raises(KeyboardInterrupt, match=r"did not report .*the link is gone"):
        check_robot(breach(step=step, rest=rest), name="r")


def test_a_test_of_a_driver_fails_with_the_report() -> None:
    assert_keeps_contract(double_integrator(0.9, 1))
    with pytest.raises(AssertionError, match="FAIL It rests at reference 0"):
        assert_keeps_contract(Offset())


def test_a_report_can_be_read_by_programs() -> None:
    report = check_robot(PuppetRobot(), moves=False)
    assert Report.model_validate_json(report.document()) == report
