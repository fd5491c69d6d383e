"""Whether the robot may move: a pure state machine over stop orders, owners and faults.

It holds no clock, thread or socket. `supervise` takes the state and an event and returns the next
state with what the agent has to do about the motion in progress.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from nufleet.shared.wire.messages import Outcome, Refusal


@dataclass(frozen=True)
class StopOrder:
    """Who stopped the robot and why."""

    sender: str
    reason: str


@dataclass(frozen=True)
class Supervision:
    """What keeps the robot from moving, and who commands the motion in progress.

    `stop` is latched until a release, `fault` (why the robot cannot be trusted to obey) until it
    has been connected anew; `motion_owner` is None while no motion is in progress.
    """

    stop: StopOrder | None = None
    fault: str | None = None
    motion_owner: str | None = None


@dataclass(frozen=True)
class StopOrdered:
    """A stop arrived."""

    order: StopOrder


@dataclass(frozen=True)
class ReleaseOrdered:
    """Somebody let the robot move again on purpose."""

    sender: str


@dataclass(frozen=True)
class OwnerLost:
    """An orchestrator's liveliness token disappeared."""

    owner: str


@dataclass(frozen=True)
class MotionBegan:
    """A motion of that owner is in progress from now on."""

    owner: str


@dataclass(frozen=True)
class MotionEnded:
    """No motion is in progress any more; `fault` says what the robot did wrong, if anything."""

    fault: str | None = None


@dataclass(frozen=True)
class Reconnected:
    """The robot was connected anew; `fault` says why that failed, if it did."""

    fault: str | None = None


Event = StopOrdered | ReleaseOrdered | OwnerLost | MotionBegan | MotionEnded | Reconnected


@dataclass(frozen=True)
class Halt:
    """Bring the motion in progress to rest now."""

    outcome: Outcome
    reason: str


def supervise(state: Supervision, event: Event) -> tuple[Supervision, Halt | None]:
    """Return the next state, and the halt that the event asks for."""
    match event:
        case StopOrdered(order):
            # A second stop is accepted too; the first order stays the reason that is shown.
            halted = replace(state, stop=state.stop or order)
            reason = f"stopped by {order.sender}: {order.reason}"
            return halted, _halt_if_moving(state, reason)
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


def refusal_to_start(state: Supervision, *, owner: str, owner_alive: bool) -> Refusal | None:
    """Return why a motion may not begin, or None when it may."""
    if state.fault is not None:
        return Refusal(
            code="fault",
            reason=f"see to the robot, then release it: {state.fault}",
        )
    if state.stop is not None:
        return Refusal(
            code="stopped",
            reason=(
                f"release it first: it was stopped by {state.stop.sender}: {state.stop.reason}"
            ),
        )
    if not owner_alive:
        return Refusal(
            code="owner-not-alive",
            reason=f"{owner} has no liveliness token, so nobody would notice if it died",
        )
    return None


def _halt_if_moving(state: Supervision, reason: str) -> Halt | None:
    return None if state.motion_owner is None else Halt(Outcome.ABORTED, reason)
