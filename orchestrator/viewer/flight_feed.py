"""Shows flights along paths as they happen: turns samples into viewer events."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.pilot import PathFlight
from nufleet.orchestrator.viewer.clock import ViewerClock
from nufleet.orchestrator.viewer.events import (
    MessageEvent,
    TakenBackEvent,
    TrackingSamplesEvent,
    ViewerEvent,
)
from nufleet.shared.arrays import FloatArray
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import TrackingTelemetry
from nufleet.shared.wire.motions import TrackingDetails


@dataclass(frozen=True)
class _Current:
    """The flight that is being drawn."""

    robot: str
    label: str
    spec: RobotSpec
    began_s: float
    """Beginning of the flight on the viewer's clock."""
    goal_id: str | None = None
    """Id of the flight's goal; None until its first samples arrive."""


class PathView:
    """An observer of flights that emits viewer events, one flight after another.

    The function `emit` that it is given must never block or raise, since it is called from the
    threads that fly the robots and receive messages.
    """

    def __init__(self, clock: ViewerClock, emit: Callable[[ViewerEvent], None]) -> None:
        self._clock, self._emit = clock, emit
        self._lock = threading.Lock()
        self._current: _Current | None = None
        self._drawn = 0

    def watch(self, fleet: Fleet) -> None:
        """Start to draw the samples that the robots stream."""
        fleet.observe_tracking(self._on_telemetry)

    def begins(self, robot: str, label: str, spec: RobotSpec) -> None:
        """Handle the beginning of a flight; `label` names it, see `flight_label`."""
        with self._lock:
            self._current = _Current(robot, label, spec, self._clock.now_s())
            self._drawn = 0

    def ended(self, flight: PathFlight) -> None:
        """Draw how a flight ended, and all its samples if some did not arrive in time."""
        with self._lock:
            current, drawn = self._current, self._drawn
            self._current = None
        if current is None:
            return
        samples, step_s, details = len(flight.actual), flight.sample_time_s, flight.details
        if drawn < samples:
            self._emit(_event(current, 0, step_s, details, flight.actual))
        if details.taken_back is not None:
            taken_s = current.began_s + details.taken_back.sample * step_s
            reason = details.taken_back.reason
            self._emit(TakenBackEvent(taken_s, current.robot, current.label, reason))
        end_s = current.began_s + samples * step_s
        if flight.failure is not None:
            self._emit(MessageEvent(end_s, "error", f"{current.label}: {flight.failure}"))
        self._clock.advance_to(end_s + 1.0)

    def _on_telemetry(self, robot: str, telemetry: TrackingTelemetry) -> None:
        with self._lock:
            current = self._current
            if current is None or robot != current.robot:
                return
            if current.goal_id is None and telemetry.first_sample == 0:
                current = self._current = replace(current, goal_id=telemetry.goal_id)
            if telemetry.goal_id != current.goal_id:
                return  # late samples that belong to an earlier flight
            self._drawn += len(telemetry.desired)
        step_s = telemetry.sample_time_s
        self._emit(_event(current, telemetry.first_sample, step_s, telemetry, telemetry.actual))


def _event(
    current: _Current,
    first_sample: int,
    sample_time_s: float,
    signals: TrackingTelemetry | TrackingDetails,
    actual: FloatArray,
) -> TrackingSamplesEvent:
    return TrackingSamplesEvent(
        t_s=current.began_s + first_sample * sample_time_s,
        robot=current.robot,
        flight=current.label,
        axes=tuple(axis.name for axis in current.spec.axes),
        unit=current.spec.axes[0].unit,
        sample_time_s=sample_time_s,
        desired=signals.desired,
        actual=actual,
        prior=signals.prior,
        mean=signals.mean,
        variance=signals.variance,
        share=signals.share,
        experts=signals.experts,
        weights=signals.weights,
    )
