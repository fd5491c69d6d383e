"""Puts the statements of the contract to a robot, and says what its driver's author has to mend."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future
from concurrent.futures import TimeoutError as TimedOut
from typing import Any, Literal, TypeVar

import numpy as np

from nufleet.robot_agent.driver_kit.statements import STATEMENTS, Statement
from nufleet.robot_agent.driver_kit.subject import Subject
from nufleet.robot_agent.motion.watched_robot import SLOW_CALL_MAX_S
from nufleet.robot_agent.robot import Robot
from nufleet.shared.errors import RobotError
from nufleet.shared.interrupts import Interrupts
from nufleet.shared.robots.drivers import load_driver
from nufleet.shared.strict import Document, Reason, Strict

T = TypeVar("T")
STATEMENT_MAX_S = 3 * SLOW_CALL_MAX_S
"""Time that the check of one statement may take."""


class Examined(Strict):
    """One statement, and whether it holds for a robot."""

    statement: Reason
    """The statement."""
    holds: bool | None
    """Whether it holds; None if it was not checked."""
    observed: Reason = ""
    """What was observed instead, or why it was not checked."""
    mend: Reason = ""
    """What to do about it."""


class Report(Document):
    """All statements of the contract, examined on one robot."""

    robot: Reason
    """Name of the robot."""
    kind: Reason
    """Kind of the robot."""
    moved: bool
    """Whether the robot was moved."""
    examined: tuple[Examined, ...]
    """The statements, in the order of a robot's life."""

    @property
    def failed(self) -> tuple[Examined, ...]:
        """The statements that do not hold."""
        return tuple(one for one in self.examined if one.holds is False)

    def __str__(self) -> str:
        lines = []
        for one in self.examined:
            mark: Literal["ok  ", "FAIL", "-   "]
            mark = "-   " if one.holds is None else "ok  " if one.holds else "FAIL"
            lines.append(f"{mark} {one.statement}")
            if one.observed:
                lines.append(f"       {one.observed}")
            if one.holds is False:
                lines.append(f"       Mend: {one.mend}")
        return "\n".join(lines)


def check_robot(
    robot: Robot, *, name: str = "robot", moves: bool = True, cuts: bool | None = None
) -> Report:
    """Examine a robot that nothing else uses; it is disconnected afterwards.

    Motions are small and slow: a fifth of the amplitude limit, a third of the limits on velocity
    and acceleration. After the first statement that leaves the robot in doubt, no other one moves
    it.

    Args:
        robot: The robot, disconnected.
        name: Name of the robot, for the report.
        moves: Whether the robot may be moved.
        cuts: Whether its motors may be cut in motion; None for simulated robots alone.

    Raises:
        KeyboardInterrupt: A person ended the examination. The robot was brought to rest, landed and
            disconnected first; the message says whether it is at rest.
    """
    subject = Subject(robot)
    with Interrupts(f"{name} is coming to rest, then this ends by itself"):
        try:
            return _report(subject, name, moves=moves, cuts=cuts)
        except KeyboardInterrupt:
            raise KeyboardInterrupt(_brought_to_rest(subject, name)) from None


def _brought_to_rest(subject: Subject, name: str) -> str:
    """Bring an interrupted robot to rest, land and disconnect it; return how that went."""
    robot = subject.robot
    calls = [subject.rest, subject.end, robot.disconnect] if subject.up else [robot.disconnect]
    failures = []
    for call in calls:
        try:
            _within_time(call)
        except Exception as error:  # noqa: BLE001 - a driver under examination may raise anything
            failures.append(_words(error))
    if failures:
        return f"{name} did not report to be at rest ({'; '.join(failures)}): look at it"
    return f"{name} is at rest"


def _report(subject: Subject, name: str, *, moves: bool, cuts: bool | None) -> Report:
    robot = subject.robot
    if cuts is None:
        cuts = robot.spec.simulated
    examined: list[Examined] = []
    doubt = ""
    for statement in STATEMENTS:
        why_not = ""
        if doubt:
            why_not = doubt
        elif statement.moves and not moves:
            why_not = "not checked, since the robot is not to be moved"
        elif statement.cuts and not cuts:
            why_not = "not checked, since its motors are not to be cut (--kill)"
        if why_not:
            examined.append(_examined(statement, None, why_not))
            continue
        observed, in_doubt = _observed(statement, subject)
        examined.append(_examined(statement, observed is None, observed or ""))
        if in_doubt:
            doubt = "not checked, since the robot failed before"
    try:
        _within_time(robot.disconnect)
    except Exception as error:  # noqa: BLE001 - a driver under examination may raise anything
        last = Statement(
            "It can be disconnected in any state.", "Raise nothing in it.", lambda _: None
        )
        examined.append(_examined(last, False, _words(error)))
    return Report(robot=name, kind=robot.spec.kind, moved=moves, examined=tuple(examined))


def assert_keeps_contract(robot: Robot | str, **settings: Any) -> None:
    """Fail with the report unless a robot keeps the contract; for tests of drivers.

    Args:
        robot: The robot, disconnected, or the name of an installed driver.
        **settings: Settings of the driver, other than its defaults.

    Raises:
        AssertionError: A statement does not hold.
        FleetFileError: There is no such driver.
    """
    if isinstance(robot, str):
        driver = load_driver(robot)
        built = {robot: driver.settings(**settings)}
        report = check_robot(driver.build(built, np.random.default_rng(0))[robot], name=robot)
    else:
        report = check_robot(robot)
    assert not report.failed, f"the driver breaks its contract:\n{report}"  # noqa: S101


def _observed(statement: Statement, subject: Subject) -> tuple[str | None, bool]:
    """Return what was observed instead of a statement, and whether the robot is in doubt now."""
    try:
        return _within_time(lambda: statement.check(subject), subject.interrupted), False
    except Exception as error:  # noqa: BLE001 - a driver under examination may raise anything
        return _words(error), True


def _words(error: Exception) -> str:
    if isinstance(error, RobotError):
        return str(error)
    if isinstance(error, TimedOut):
        return f"the driver has not returned after {STATEMENT_MAX_S:.0f} s"
    return f"the driver raised {error!r}, where only RobotError is expected"


def _within_time(call: Callable[[], T], interrupted: threading.Event | None = None) -> T:
    """Return what a call returns; after an interrupt, say so and wait until it has ended."""
    done: Future[T] = Future()

    def work() -> None:
        try:
            done.set_result(call())
        except BaseException as error:  # noqa: BLE001 - raised where it is waited for
            done.set_exception(error)

    # A daemon, since no thread can end a driver that hangs.
    working = threading.Thread(target=work, name="driver under examination", daemon=True)
    working.start()
    try:
        return done.result(STATEMENT_MAX_S)
    except KeyboardInterrupt:
        if interrupted is not None:
            interrupted.set()
        working.join(STATEMENT_MAX_S)
        raise


def _examined(statement: Statement, holds: bool | None, observed: str) -> Examined:
    mend = statement.mend if holds is False else ""
    return Examined(statement=statement.text, holds=holds, observed=observed, mend=mend)
