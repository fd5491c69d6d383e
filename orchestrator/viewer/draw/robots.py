"""Draws the states of the robots as lanes over time. Imports Rerun."""

from __future__ import annotations

import rerun as rr

from nufleet.orchestrator.viewer.draw.log import Log
from nufleet.orchestrator.viewer.draw.marks import send
from nufleet.orchestrator.viewer.draw.palette import Colour
from nufleet.orchestrator.viewer.events import RobotStateEvent

# These differ from the robots' own colours: calm for planned states, warm for those that need a
# person's attention.
_STATES: dict[str, Colour] = {
    "idle": (84, 90, 104),
    "running": (54, 128, 140),
    "resting": (120, 132, 160),
    "stopped": (214, 150, 40),
    "fault": (200, 60, 50),
    "lost": (150, 60, 120),
}


class RobotStates:
    """A view with one lane for each robot that shows its status, and its progress as a series."""

    def __init__(self, stream: rr.RecordingStream, log: Log) -> None:
        self._stream = stream
        self._log = log
        self._waiting: dict[str, list[RobotStateEvent]] = {}
        self._status: dict[str, str] = {}
        self._reason: dict[str, str] = {}

    def add(self, event: RobotStateEvent) -> None:
        """Keep an event for the next `draw`."""
        self._waiting.setdefault(event.robot, []).append(event)

    def draw(self) -> None:
        """Draw the events that were kept, in one message for each robot."""
        waiting, self._waiting = self._waiting, {}
        for robot, events in waiting.items():
            self._draw_progress(robot, events)
            self._draw_changes(robot, events)

    def _draw_progress(self, robot: str, events: list[RobotStateEvent]) -> None:
        send(
            self._stream,
            f"progress/{robot}",
            [event.t_s for event in events],
            rr.Scalars.columns(scalars=[event.progress for event in events]),
        )

    def _draw_changes(self, robot: str, events: list[RobotStateEvent]) -> None:
        # Lanes are sorted by their paths: the target comes first, however many robots follow.
        path = f"state/{'1-target' if events[0].is_target else '2-source'}/{robot}"
        if robot not in self._status:
            self._stream.log(
                path,
                rr.StateConfiguration(values=list(_STATES), colors=list(_STATES.values())),
                static=True,
            )
        changes: list[RobotStateEvent] = []
        for event in events:
            if self._status.get(robot) != event.status:
                self._status[robot] = event.status
                changes.append(event)
            if event.reason and self._reason.get(robot) != event.reason:
                bad = event.status in ("stopped", "fault", "lost")
                text = f"{robot}: {event.reason}"
                self._log.say(event.t_s, "warning" if bad else "info", text)
            self._reason[robot] = event.reason
        if changes:
            send(
                self._stream,
                path,
                [event.t_s for event in changes],
                rr.StateChange.columns(state=[event.status for event in changes]),
            )
