"""Decides whether the robot may move: a pure state machine over stop orders, owners and faults.

It holds no clock, thread or socket. `supervise` takes the state and an event, and returns the next
state together with the halt of the motion in progress, if one is needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from nufleet.shared.wire.messages import Outcome, Refusal

STOPS_REMEMBERED = 64


@dataclass(frozen=True)
class StopOrder:
    """An order to stop the robot."""

    sender: str
    """Name of the sender."""

    reason: str
    """Reason that the sender gave."""

    order_id: str | None = None
    """Id that copies of the order share; None for an order of which no copy is known."""


@dataclass(frozen=True)
class Supervision:
    """The state of the machine: all that keeps the robot from moving, and its motion's owner."""

    stop: StopOrder | None = None
    """Stop in force, latched until a release; None without one."""

    obeyed: tuple[tuple[str, str], ...] = ()
    """Sender and id of the last stops that were obeyed, the latest last."""

    fault: str | None = None
    """Why the robot cannot be trusted to obey, latched until it is reconnected; None when it
    can."""

    unfit: str | None = None
    """Why the robot's health keeps it from moving, until the next report; None when it does not."""

    motion_owner: str | None = None
    """Orchestrator that commands the motion in progress; None while there is none."""


@dataclass(frozen=True)
class StopOrdered:
    """A stop arrived."""

    order: StopOrder
    """The order that arrived."""


@dataclass(frozen=True)
class ReleaseOrdered:
    """A release arrived: the robot may move again."""

    sender: str
    """Name of the sender."""


@dataclass(frozen=True)
class OwnerLost:
    """An orchestrator's liveliness token disappeared."""

    owner: str
    """Name of the orchestrator."""


@dataclass(frozen=True)
class MotionBegan:
    """A motion of this owner is in progress from now on."""

    owner: str
    """Name of the orchestrator that commands it."""


@dataclass(frozen=True)
class MotionEnded:
    """The motion in progress has ended."""

    fault: str | None = None
    """What the robot did wrong; None if nothing."""


@dataclass(frozen=True)
class Reconnected:
    """An attempt to reconnect the robot has ended."""

    fault: str | None = None
    """Reason why it failed; None if it succeeded."""


@dataclass(frozen=True)
class FaultFound:
    """Something other than a motion's end showed that the robot cannot be trusted to obey."""

    fault: str
    """What is wrong with the robot."""


@dataclass(frozen=True)
class HealthReported:
    """The robot reported its health."""

    unfit: str | None
    """Reason why it may not move; None if it may."""


Event = (
    StopOrdered
    | ReleaseOrdered
    | OwnerLost
    | MotionBegan
    | MotionEnded
    | Reconnected
    | FaultFound
    | HealthReported
)


@dataclass(frozen=True)
class Halt:
    """An order to bring the motion in progress to rest now."""

    outcome: Outcome
    """Outcome to report for the motion."""

    reason: str
    """Reason to report for it."""


def supervise(state: Supervision, event: Event) -> tuple[Supervision, Halt | None]:
    """Return the next state, and the halt that the event requires; None when it requires none."""
    match event:
        case StopOrdered(order):
            return _stopped(state, order)
        case ReleaseOrdered():
            return replace(state, stop=None), None
        case OwnerLost(owner):
            if state.motion_owner != owner:
                return state, None
            return state, _halt_if_moving(state, f"its owner {owner} is gone")
        case MotionBegan(owner):
            return replace(state, motion_owner=owner), None
        case MotionEnded(fault):
            return replace(state, motion_owner=None, fault=state.fault or fault), None
        case Reconnected(fault):
            return replace(state, fault=fault), None
        case FaultFound(fault):
            return replace(state, fault=state.fault or fault), _halt_if_moving(state, fault)
        case HealthReported(unfit):
            return replace(state, unfit=unfit), _halt_if_moving(state, unfit)


def is_copy(state: Supervision, order: StopOrder) -> bool:
    """Return whether a stop is another copy of one that was obeyed.

    A stop is sent on several ways at once. The copy that is the last to arrive must not stop a
    robot that a person has released meanwhile.
    """
    return (order.sender, order.order_id) in state.obeyed


def refusal_to_start(state: Supervision, *, owner: str, owner_alive: bool) -> Refusal | None:
    """Return why a motion may not begin; None when it may.

    Args:
        state: Current state.
        owner: Name of the orchestrator that asks for the motion.
        owner_alive: Whether the orchestrator's liveliness token is present.
    """
    if state.fault is not None:
        return Refusal(
            code="fault",
            reason=f"inspect the robot, then release it: {state.fault}",
        )
    if state.stop is not None:
        return Refusal(
            code="stopped",
            reason=(
                f"release it first with `nufleet release`: it was stopped by {state.stop.sender}: "
                f"{state.stop.reason}"
            ),
        )
    if state.unfit is not None:
        return Refusal(code="not-ready", reason=f"it is not ready to move: {state.unfit}")
    if not owner_alive:
        return Refusal(
            code="owner-not-alive",
            reason=f"{owner} has no liveliness token, so its death would not be noticed",
        )
    return None


def _stopped(state: Supervision, order: StopOrder) -> tuple[Supervision, Halt | None]:
    obeyed = state.obeyed
    if is_copy(state, order):
        if state.stop is None:
            return state, None
    elif order.order_id is not None:
        obeyed = (*obeyed, (order.sender, order.order_id))[-STOPS_REMEMBERED:]
    # A second stop is accepted, too; the first order remains the reason that is shown.
    halted = replace(state, stop=state.stop or order, obeyed=obeyed)
    return halted, _halt_if_moving(state, f"stopped by {order.sender}: {order.reason}")


def _halt_if_moving(state: Supervision, reason: str | None) -> Halt | None:
    if state.motion_owner is None or reason is None:
        return None
    return Halt(Outcome.ABORTED, reason)
