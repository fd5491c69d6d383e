"""Flights along paths as far as they are known: priors, positions and errors."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from nufleet.orchestrator.flights.labels import BASELINE, prior_and_path
from nufleet.orchestrator.viewer.events import TrackingSamplesEvent
from nufleet.shared.arrays import FloatArray

EARLIER_MAX = 12
"""Limit on the number of earlier flights along the same path that stay in a picture."""

FOLLOW_S = 10.0
"""When several robots fly at once, a picture follows one until it has been idle for this many
seconds."""

PAUSE_S = 1.0
"""Longest gap between samples of one flight. After a longer one the path is being flown again: the
robot first had to return to its start."""


@dataclass(eq=False)
class Flight:
    """A flight along a path as far as it is known."""

    robot: str
    """Name of the robot that flies."""
    label: str
    """Name of the flight; see `flight_label`."""
    axes: tuple[str, ...]
    """Names of the robot's axes."""
    unit: str
    """Unit of these axes."""
    sample_time_s: float
    """Time between two samples."""
    time_s: FloatArray
    """Times of the samples on the viewer's clock, shape (samples,)."""
    desired: FloatArray
    """Desired positions in `unit`, shape (samples, axes)."""
    actual: FloatArray
    """Measured positions in `unit`, shape (samples, axes)."""
    new: list[TrackingSamplesEvent] = field(default_factory=list)
    """Events that arrived since the flight was last drawn."""
    taken_back_s: float | None = None
    """Time at which the guard withdrew the prior; None when it did not."""

    @staticmethod
    def begun_by(event: TrackingSamplesEvent) -> Flight:
        """Return the flight that begins with the samples of an event."""
        nothing = np.empty((0, len(event.axes)))
        flight = Flight(
            robot=event.robot,
            label=event.flight,
            axes=event.axes,
            unit=event.unit,
            sample_time_s=event.sample_time_s,
            time_s=np.empty(0),
            desired=nothing,
            actual=nothing,
        )
        flight.add(event)
        return flight

    @property
    def prior(self) -> str:
        """Name of the source that gave the prior, or BASELINE, NO_PRIOR or OWN."""
        return prior_and_path(self.label)[0]

    @property
    def path(self) -> str:
        """Name of the drawing with the speed; flights with the same path can be compared."""
        return prior_and_path(self.label)[1]

    @property
    def rms_error(self) -> float:
        """RMS distance to the path over the known samples, in the unit of the axes."""
        return math.sqrt(float(np.mean(np.sum((self.actual - self.desired) ** 2, axis=1))))

    @property
    def errors_milli(self) -> FloatArray:
        """Distance to the path in thousandths of the unit of the axes, shape (samples,)."""
        return np.asarray(1e3 * np.linalg.norm(self.actual - self.desired, axis=1))

    def continued_by(self, event: TrackingSamplesEvent) -> bool:
        """Return whether the samples of an event continue this flight."""
        pause_s = event.t_s - (self.time_s[-1] + self.sample_time_s)
        return event.flight == self.label and abs(pause_s) < PAUSE_S

    def compares_with(self, other: Flight | None) -> bool:
        """Return whether another flight is of the same robot along the same path."""
        return other is not None and (other.robot, other.path) == (self.robot, self.path)

    def result(self, so_far: str = "") -> str:
        """Return who gave the prior, and the RMS error until now."""
        taken_back = "" if self.taken_back_s is None else ", withdrawn"
        return f"{self.prior}  {self.rms_error * 1e3:.1f}{so_far}{taken_back}"

    def add(self, event: TrackingSamplesEvent) -> None:
        """Append the samples of an event."""
        self.new.append(event)
        time_s = event.t_s + np.arange(len(event.actual)) * event.sample_time_s
        self.time_s = np.concatenate([self.time_s, time_s])
        self.desired = np.concatenate([self.desired, event.desired])
        self.actual = np.concatenate([self.actual, event.actual])

    def at(self, t_s: float) -> int:
        """Return the index of the last sample up to a time; 0 when there is none."""
        return max(0, int(np.searchsorted(self.time_s, t_s + 1e-6, side="right")) - 1)


class Row(NamedTuple):
    """A row of a list of flights."""

    text: str
    """The text."""
    prior: str | None = None
    """Who gave the prior of the flight, whose colour the text has; None for a heading."""


class Compared:
    """The flights of a robot along one path: the one in progress, and earlier ones."""

    def __init__(self) -> None:
        self.flight: Flight | None = None
        self.earlier: list[Flight] = []

    def takes(self, flight: Flight) -> bool:
        """Return whether a flight is the one in progress now, which replaces an earlier one.

        When several robots fly at once, one is followed until it has been idle for `FOLLOW_S`.
        """
        before = self.flight
        if before is flight:
            return True
        others: list[Flight] = []
        if before is not None:
            idle_s = flight.time_s[-1] - before.time_s[-1]
            if before.robot != flight.robot and idle_s < FOLLOW_S:
                return False
            if flight.compares_with(before):
                others = [*self.earlier, before]
        # A flight that is flown or sent again replaces its earlier version.
        self.earlier = [other for other in others if other.label != flight.label][-EARLIER_MAX:]
        self.flight = flight
        return True

    @property
    def whole(self) -> bool:
        """Whether the flight in progress went as far along the path as every earlier one."""
        lengths = [len(earlier.time_s) for earlier in self.earlier]
        return self.flight is not None and len(self.flight.time_s) >= max(lengths, default=np.inf)

    def rows(self) -> list[Row]:
        """Return the path and its flights, the smallest error on top, the current one last."""
        flight = self.flight
        if flight is None:
            return []
        done = sorted([*self.earlier, *[flight] * self.whole], key=lambda one: one.rms_error)
        rows = [Row(flight.path), Row(f"RMS error [m{flight.unit}]")]
        rows += [Row(one.result(), one.prior) for one in done]
        if not self.whole:
            rows.append(Row(flight.result(" so far"), flight.prior))
        return rows


@dataclass(frozen=True)
class Outcome:
    """The outcome of a flight, which is provisional while the flight is in progress."""

    rms_error: float
    """RMS tracking error in the unit of the axes."""
    taken_back: bool
    """Whether the guard withdrew the prior."""


class Outcomes:
    """The outcomes of all flights by path and prior; a repeated flight replaces the earlier one."""

    def __init__(self) -> None:
        self._of: dict[tuple[str, str], dict[str, Outcome]] = {}
        self._unit = ""

    def note(self, flight: Flight) -> None:
        """Keep the present outcome of a flight."""
        outcome = Outcome(flight.rms_error, flight.taken_back_s is not None)
        self._of.setdefault((flight.robot, flight.path), {})[flight.prior] = outcome
        self._unit = flight.unit

    def table(self) -> str:
        """Return the errors as Markdown: a row for each path, the best of each in bold."""
        priors = list(dict.fromkeys(prior for row in self._of.values() for prior in row))
        several = len({robot for robot, _ in self._of}) > 1
        lines = [
            f"**RMS tracking error** in m{self._unit}, by source of the prior (\\* withdrawn)",
            "",
            f"| | {' | '.join(priors)} |",
            "|:---" + "|---:" * len(priors) + "|",
        ]
        for (robot, path), row in self._of.items():
            name = f"{robot}: {path}" if several else path
            lines.append(f"| {name} | {' | '.join(_cells(row, priors))} |")
        if len(self._of) > 1 and all(BASELINE in row for row in self._of.values()):
            shares = [_reduction(list(self._of.values()), prior) for prior in priors]
            lines.append(f"| *less than the baseline* | {' | '.join(shares)} |")
        return "\n".join(lines)


def _cells(row: dict[str, Outcome], priors: list[str]) -> list[str]:
    best = min(outcome.rms_error for outcome in row.values())
    cells = []
    for prior in priors:
        outcome = row.get(prior)
        if outcome is None:
            cells.append("")
            continue
        mark = "**" if outcome.rms_error == best and len(row) > 1 else ""
        star = "\\*" if outcome.taken_back else ""
        cells.append(f"{mark}{outcome.rms_error * 1e3:.1f}{mark}{star}")
    return cells


def _reduction(rows: list[dict[str, Outcome]], prior: str) -> str:
    """Return the error reduction against the baseline, averaged over the paths (paper, Table I)."""
    if prior == BASELINE or not any(prior in row for row in rows):
        return ""
    shares = [
        1 - row[prior].rms_error / row[BASELINE].rms_error
        for row in rows
        if prior in row and row[BASELINE].rms_error > 0
    ]
    return f"{100 * float(np.mean(shares)):.0f} %" if shares else ""
