"""Ways of flying one path, what is expected of each, and which to take."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

from pydantic import model_serializer

from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN
from nufleet.shared.strict import NonNegative, Strict
from nufleet.shared.text import in_thousandths, readable_unit
from nufleet.shared.wire.messages import Foreseen
from nufleet.shared.wire.motions import PredictedError

_BETTER = 0.9
"""Share of the error of the best way now, below which one after more flying is worth naming."""


class WayRecord(Strict):
    """A way of flying a path: what is expected of it and, once flown, what came of it.

    Errors are root mean squares in the unit of the target's axes.
    """

    way: str
    """Name of a source, `mixture` for those of all sources, `own` for the target's model of itself,
    `none` for learning online from nothing, or `baseline`."""
    own_flight_s: NonNegative
    """Duration of the target's own motions that come before; that of its least known axis."""
    predicted_rms_m: NonNegative | None = None
    """Error that the target expects; None if it could not fly so, or cannot tell."""
    predicted_low_m: NonNegative | None = None
    """Error that it expects to exceed with a probability of 95 %."""
    predicted_high_m: NonNegative | None = None
    """Error that it expects to stay below with a probability of 95 %."""
    rms_m: NonNegative | None = None
    """Error that was measured; None until it was flown."""
    reduction_percent: float | None = None
    """Percentage by which that is below the baseline's; None until both were flown."""
    taken_back: str | None = None
    """Why the guard withdrew it in flight; None if it did not, or if it was not flown."""
    unseen: str | None = None
    """What of the path is unlike all motions that the target knows itself from, and what to do; in
    the record of the baseline."""
    reason: str | None = None
    """Why nothing is expected of it."""

    @model_serializer
    def _serialised(self) -> dict[str, Any]:
        # What was not predicted or not flown is null, also in documents that leave nulls out.
        return {name: getattr(self, name) for name in type(self).model_fields}

    @staticmethod
    def of(way: str, own_flight_s: float, found: Foreseen) -> WayRecord:
        """Return the record of what a target foresees of a way."""
        predicted = found.predicted
        if predicted is None:
            return WayRecord(way=way, own_flight_s=own_flight_s, reason=found.reason)
        return WayRecord(
            way=way,
            own_flight_s=own_flight_s,
            predicted_rms_m=predicted.rms,
            predicted_low_m=predicted.low,
            predicted_high_m=predicted.high,
            unseen=found.reason or None,
        )

    @property
    def predicted(self) -> PredictedError | None:
        """Error that the target expects; None if there is none."""
        rms, low, high = self.predicted_rms_m, self.predicted_low_m, self.predicted_high_m
        if rms is None or low is None or high is None:
            return None
        return PredictedError(rms=rms, low=low, high=high)


@dataclass(frozen=True)
class Foresight:
    """What a target expects of all ways to fly one path."""

    target: str
    """Name of the robot that would fly."""
    path: str
    """What would be flown, in words."""
    unit: Literal["m", "rad"]
    """Unit of its axes."""
    ways: tuple[WayRecord, ...]
    """The ways, those that can be flown now before those that need more flying."""

    @property
    def present_s(self) -> float:
        """For how long the target has flown until now, as far as it knows its least known axis."""
        return min((way.own_flight_s for way in self.ways), default=0.0)

    @property
    def now(self) -> dict[str, PredictedError]:
        """Error of every way that can be flown now, by its name."""
        return _predicted(self._split()[0])

    @property
    def unseen(self) -> str | None:
        """What of the path is unlike all motions that the target knows itself from, if any."""
        return next((way.unseen for way in self.ways if way.unseen), None)

    @property
    def later(self) -> tuple[WayRecord, ...]:
        """Ways that need more flying of the target's own first."""
        return self._split()[1]

    @property
    def chosen(self) -> str | None:
        """Name of the way to fly now: the one with the least expected error; None without any.

        Where two are expected to leave the same, the one that takes less is chosen.
        """
        effort = {BASELINE: 0, OWN: 1, NO_PRIOR: 2, MIXTURE: 4}
        now = self.now
        return min(now, key=lambda way: (now[way].rms, effort.get(way, 3)), default=None)

    def _split(self) -> tuple[tuple[WayRecord, ...], tuple[WayRecord, ...]]:
        now = tuple(way for way in self.ways if way.own_flight_s <= self.present_s)
        return now, self.ways[len(now) :]


def advice(foresight: Foresight) -> str:
    """Return one sentence: which way to fly, what it is expected to leave, and what comes next."""
    now, chosen, unit = foresight.now, foresight.chosen, foresight.unit
    if chosen is None:
        return f"no way to fly {foresight.path} could be predicted"
    expected = now[chosen]
    transfers = {way: left for way, left in now.items() if way == MIXTURE or _is_source(way)}
    parts = [f"{_order(chosen)}: {error_range(expected, unit)} expected"]
    if chosen != BASELINE and BASELINE in now:
        parts[0] += f", the baseline leaves {in_thousandths(now[BASELINE].rms, unit)}"
    if chosen not in transfers and transfers:
        best = min(transfers, key=lambda way: transfers[way].rms)
        named = "a mixture of the sources" if best == MIXTURE else f"{best}'s experience"
        left = in_thousandths(transfers[best].rms, unit)
        parts.append(f"do not transfer: the best of it, {named}, would leave {left}")
    if not transfers and any(_is_source(way.way) for way in foresight.ways):
        parts.append("no source has an experience yet that could be rehearsed")
    sooner = _soonest(foresight.later, expected.rms)
    if sooner is not None:
        record, found = sooner
        more_s = record.own_flight_s - foresight.present_s
        parts.append(
            f"after {more_s:.0f} s of rich flight its own model is "
            f"expected to leave {in_thousandths(found.rms, unit)}"
        )
    return "; ".join(parts)


def error_range(error: PredictedError, unit: str) -> str:
    """Return an error with its bounds, such as "5.1 mm (4.6 to 5.9)"."""
    factor, _ = readable_unit(error.rms, unit)
    low, high = factor * error.low, factor * error.high
    return f"{in_thousandths(error.rms, unit)} ({low:.3g} to {high:.3g})"


def described(record: WayRecord, present_s: float) -> str:
    """Return the name of a way in words, given for how long the target has flown until now."""
    names = {
        BASELINE: "baseline alone",
        NO_PRIOR: "learning from nothing",
        OWN: "own model",
        MIXTURE: "mixture of the sources",
    }
    name = names.get(record.way, f"experience of {record.way}")
    more_s = record.own_flight_s - present_s
    return f"{name} after {more_s:.0f} s of rich flight" if more_s > 0 else name


def _is_source(way: str) -> bool:
    return way not in (BASELINE, NO_PRIOR, OWN, MIXTURE)


def _order(way: str) -> str:
    orders = {
        BASELINE: "fly with the baseline alone",
        NO_PRIOR: "fly first with online learning alone",
        OWN: "fly first with its own model",
        MIXTURE: "fly first with a mixture of the sources' experiences",
    }
    return orders.get(way, f"fly first with {way}'s experience")


def _soonest(later: Sequence[WayRecord], rms: float) -> tuple[WayRecord, PredictedError] | None:
    """Return the first of the ways that is expected to be worth its flight; None without one."""
    for record in later:
        found = record.predicted
        if found is not None and found.rms < _BETTER * rms:
            return record, found
    return None


def _predicted(ways: Iterable[WayRecord]) -> dict[str, PredictedError]:
    return {way.way: found for way in ways if (found := way.predicted) is not None}
