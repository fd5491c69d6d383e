"""The contract of a robot as statements, each of which can be put to a driver.

They are in the order of a robot's life: connected, begun, at rest, moving, at rest, ended,
disconnected. A statement returns what was observed instead if it does not hold.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from nufleet.robot_agent.driver_kit.subject import HOLD_S, Subject, gentle_hill
from nufleet.robot_agent.motion.monitor import rest_error_max, rest_failure
from nufleet.robot_agent.motion.resampling import outputs_at_samples
from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.shared.robots.health import Health

AT_ONCE_S = 0.2
"""Time in which `health` and `kill` have to return."""

PERIOD_ERROR = 0.05
"""Largest relative error of a real robot's sample time."""

FOLLOWS_MIN = 0.2
"""Least response to a slow reference, as a share of it: its sign and its unit are right."""

NOISE_DEVIATIONS = 6.0
"""Standard deviations of the noise at rest that a single sample may be off."""


Check = Callable[[Subject], str | None]


@dataclass(frozen=True)
class Statement:
    """One sentence of the contract."""

    text: str
    """The sentence."""

    mend: str
    """What the author of a driver does about it if it does not hold."""

    check: Check
    """Function that returns what was observed instead; None when the statement holds."""

    moves: bool = False
    """Whether a robot moves when it is checked."""

    cuts: bool = False
    """Whether its motors are cut."""


STATEMENTS: list[Statement] = []
"""All statements, in the order in which they are checked."""


def _states(
    text: str, mend: str, *, moves: bool = False, cuts: bool = False
) -> Callable[[Check], Check]:
    def add(check: Check) -> Check:
        STATEMENTS.append(Statement(text, mend, check, moves, cuts))
        return check

    return add


@_states(
    "Its description can be read while it is disconnected, and stays the same.",
    "Build `spec` in `__init__` from the settings, and return it from a property.",
)
def _describes(subject: Subject) -> str | None:
    first, second = subject.robot.spec, subject.robot.spec
    return None if first == second else f"it was {first}, and then {second}"


@_states(
    "It connects, and a robot that was connected before connects again.",
    "Open the link and wait for a first measurement in `connect`; release everything in "
    "`disconnect`, also after a `connect` that failed.",
)
def _connects(subject: Subject) -> str | None:
    subject.robot.connect()
    subject.robot.disconnect()
    subject.robot.connect()
    return None


@_states(
    "It reports its health at once, or None.",
    "Keep the newest health in an attribute that the thread of your link writes.",
)
def _reports_health(subject: Subject) -> str | None:
    took_s = math.inf
    for _ in range(3):  # a busy machine delays one call, a driver that asks its robot all of them
        began_s = time.monotonic()
        health = subject.robot.health()
        took_s = min(took_s, time.monotonic() - began_s)
    if health is None:
        return None
    if not isinstance(health, Health):
        return f"`health` returned {health!r}, which is no Health"
    if took_s > AT_ONCE_S:
        return f"it took {took_s:.2g} s"
    return None if health.ready else f"it is not ready: {health.reason}"


@_states(
    "It gets ready to move.",
    "Arm, take off and come to rest at reference 0 in `begin`; a robot that needs nothing of this "
    "leaves `begin` as it is.",
    moves=True,
)
def _begins(subject: Subject) -> str | None:
    subject.begin()
    return None


@_states(
    "It rests at reference 0, measured by one finite number per axis.",
    "Hold reference 0 after `begin`, `connect` and `rest`; count outputs from there, in the units "
    "of the axes.",
)
def _rests_at_zero(subject: Subject) -> str | None:
    measured, spec = subject.measured(), subject.robot.spec
    if measured.shape[1:] != (len(spec.axes),):
        return f"`measure_output` returned shape {measured.shape[1:]} for {len(spec.axes)} axes"
    failure = rest_failure(spec, measured, np.zeros(len(spec.axes)))
    if failure is None:
        subject.noise = measured.std(axis=0, ddof=1)
    return failure


@_states(
    "It stays where it rests while its reference is 0.",
    "Send reference 0 to the controller itself rather than the present position.",
    moves=True,
)
def _holds_zero(subject: Subject) -> str | None:
    spec = subject.robot.spec
    outputs = subject.hold()
    noise = np.maximum(outputs.std(axis=0), subject.known_noise)
    subject.noise = noise
    for i, axis in enumerate(spec.axes):
        away = float(np.abs(outputs[:, i]).max())
        if away > rest_error_max(spec, axis) + NOISE_DEVIATIONS * noise[i]:
            return f"axis {axis.name} moved to {away:.3g} {axis.unit}"
    return None


@_states(
    "A real robot takes its sample time for each sample.",
    "Wait in `step` until the next sample is due, counted from the first one; do not sleep for a "
    "fixed time after the work.",
)
def _keeps_time(subject: Subject) -> str | None:
    spec = subject.robot.spec
    if spec.simulated or subject.played < 2:
        return None
    period_s = subject.lasted_s / subject.played
    if abs(period_s / spec.sample_time_s - 1) <= PERIOD_ERROR:
        return None
    return (
        f"{subject.played} samples took {1e3 * period_s:.3g} ms each instead of "
        f"{1e3 * spec.sample_time_s:.3g} ms"
    )


@_states(
    "The output of a sample is measured before its reference acts.",
    "Read the newest measurement in `step` before you send the reference.",
    moves=True,
)
def _measures_first(subject: Subject) -> str | None:
    spec = subject.robot.spec
    for i, axis in enumerate(spec.axes):
        jump = np.zeros((4, len(spec.axes)))
        jump[2:, i] = rest_error_max(spec, axis)
        before, _, at = subject.play(jump)[:3, i]
        subject.rest()
        most = 0.5 * jump[2, i] + NOISE_DEVIATIONS * subject.known_noise[i]
        if abs(at - before) > most:
            return (
                f"axis {axis.name} was at {before:.3g} {axis.unit}, and at {at:.3g} {axis.unit} in "
                f"the sample whose reference was {jump[2, i]:.3g} {axis.unit}"
            )
    return None


@_states(
    "Each axis follows its own reference, with the same sign and unit.",
    "Compare the order of `spec.axes` with the columns that you send and measure, and the "
    "directions and units of both.",
    moves=True,
)
def _follows(subject: Subject) -> str | None:
    spec = subject.robot.spec
    for i, axis in enumerate(spec.axes):
        hill = gentle_hill(subject.robot, i)
        references = np.zeros((len(hill), len(spec.axes)))
        references[:, i] = hill
        outputs = subject.play(references)
        record = subject.robot.record()
        if record is not None:
            outputs, _ = outputs_at_samples(record, len(references), spec)
        subject.rest()
        # Least-squares gains of all axes on this one's reference, away from its mean.
        centred = hill - hill.mean()
        gains = centred @ outputs / (centred @ centred)
        strongest = int(np.argmax(np.abs(gains)))
        if strongest != i:
            return f"reference {axis.name} moves axis {spec.axes[strongest].name}"
        if gains[i] < FOLLOWS_MIN:
            return (
                f"a slow reference of {hill.max():.3g} {axis.unit} on axis {axis.name} gives "
                f"{gains[i]:.2g} times as much"
            )
    return None


@_states(
    "What it records covers all samples since it rested, in increasing times.",
    "Append the time of each reference in `step` and of each measurement in the thread of your "
    "link, converted to one clock; clear both in `rest`.",
    moves=True,
)
def _records(subject: Subject) -> str | None:
    spec = subject.robot.spec
    subject.hold()
    record = subject.robot.record()
    try:
        if record is not None:
            outputs_at_samples(record, subject.played, spec)
    finally:
        subject.rest()
    return None


@_states(
    "The state that it observes begins with the output of the same sample.",
    "Keep the measurement that `observe` returned until the next `step` returns it, too.",
    moves=True,
)
def _observes(subject: Subject) -> str | None:
    robot = subject.robot
    shape = (len(robot.spec.axes), len(robot.state_names))
    seen = robot.observe()
    if np.shape(seen) != shape:
        return f"`observe` returned shape {np.shape(seen)} instead of {shape}"
    output = subject.play(np.zeros((1, shape[0])))[0]
    subject.rest()
    if shape[1] and not np.array_equal(seen[:, 0], output):
        return f"`observe` saw {seen[:, 0]}, and `step` returned {output}"
    return None


@_states(
    "It reports its health while it moves.",
    "Take no lock in `health` that `step` holds.",
    moves=True,
)
def _reports_moving(subject: Subject) -> str | None:
    took_s: list[float] = []
    over = threading.Event()

    def ask() -> None:
        while not over.is_set():
            began_s = time.monotonic()
            subject.robot.health()
            took_s.append(time.monotonic() - began_s)
            over.wait(0.01)

    asking = threading.Thread(target=ask, name="asking for health", daemon=True)
    asking.start()
    try:
        subject.hold()
    finally:
        over.set()
        asking.join(AT_ONCE_S)
        subject.rest()
    late = not took_s or max(took_s) > HOLD_S
    return f"`health` took {max(took_s, default=math.inf):.2g} s during a motion" if late else None


@_states(
    "It comes to rest at reference 0 from the middle of a motion.",
    "Return along a smooth path from the last reference in `rest`, and wait until the robot is "
    "there and still.",
    moves=True,
)
def _comes_to_rest(subject: Subject) -> str | None:
    spec = subject.robot.spec
    for i in range(len(spec.axes)):
        hill = gentle_hill(subject.robot, i)
        up = np.zeros((len(hill) // 2, len(spec.axes)))
        up[:, i] = hill[: len(up)]
        subject.play(up)
        subject.rest()
        failure = _rests_at_zero(subject)
        if failure is not None:
            return failure
    return None


@_states(
    "It ends, and begins again.",
    "Land and disarm in `end`; `begin` has to work any number of times.",
    moves=True,
)
def _begins_again(subject: Subject) -> str | None:
    subject.end()
    subject.begin()
    failure = _rests_at_zero(subject)
    subject.end()
    return failure


@_states(
    "A second `disconnect` does nothing, and a disconnected robot refuses to move.",
    "Forget the link in `disconnect`, and raise RobotError in `step` without one.",
)
def _disconnects(subject: Subject) -> str | None:
    robot = subject.robot
    robot.disconnect()
    robot.disconnect()
    try:
        robot.step(np.zeros(len(robot.spec.axes)))
    except RobotError:
        return None
    return "`step` moved a robot that was disconnected"


@_states(
    "Its motors can be cut during a motion, or it says that they cannot.",
    "Send the emergency stop in `kill` without waiting for anything; raise RobotDownError in all "
    "other calls until the next `connect`.",
    moves=True,
    cuts=True,
)
def _can_be_killed(subject: Subject) -> str | None:
    robot = subject.robot
    robot.connect()
    subject.begin()
    subject.play(np.zeros((3, len(robot.spec.axes))))
    began_s = time.monotonic()
    try:
        robot.kill()
    except RobotError:
        robot.rest()
        subject.end()
        robot.disconnect()
        return None
    subject.up = False
    took_s = time.monotonic() - began_s
    try:
        robot.step(np.zeros(len(robot.spec.axes)))
    except RobotDownError:
        robot.disconnect()
        return None if took_s <= AT_ONCE_S else f"`kill` took {took_s:.2g} s"
    return "`step` still moves it"
