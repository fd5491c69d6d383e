"""What a demonstration showed: a table of the ways to fly, and what follows from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from rich.console import RenderableType
from rich.table import Table

from nufleet.orchestrator.evaluation.flight_documents import DemoResult
from nufleet.orchestrator.evaluation.results import FlightRecord, InverseResult
from nufleet.orchestrator.flights.labels import BASELINE, MIXTURE, NO_PRIOR, OWN

MATTERS = 1.2
"""Ratio of two errors from which on they count as different."""


@dataclass(frozen=True)
class Way:
    """One way in which the target flew the drawing. Errors are in the unit of its axes."""

    name: str
    """What it flew with, as printed."""
    rms: float | None
    """Error that was flown; None if the path was not finished."""
    flight: FlightRecord | None
    """The flight; None in a result that does not hold it."""
    psi: float | None = None
    """Estimated distance of the source; None without a source."""
    expected: float | None = None
    """Error that the ranking's tests predict; None without such a prediction."""
    guarded: bool = True
    """Whether the guard could intervene."""

    @property
    def taken_back(self) -> str | None:
        """Why the guard withdrew the experience; None where it did not."""
        return None if self.flight is None else self.flight.taken_back

    def flown(self) -> str:
        """Return the error that was flown, or why there is none."""
        if self.flight is not None and not self.flight.flown:
            return "not flown"
        return "not finished" if self.rms is None else _number(self.rms)

    def predicted(self) -> str:
        """Return the error predicted before the flight, with its interval where one is known.

        The target's own prediction comes first: it is of the very flight, learning included. The
        tests predict what the source's inverse leaves as a prefilter.
        """
        flight = self.flight
        if flight is None or flight.predicted_rms_m is None:
            return _number(self.expected)
        low, high = flight.predicted_low_m, flight.predicted_high_m
        median = _number(flight.predicted_rms_m)
        if low is None or high is None:
            return median
        return f"{median} ({_number(low)}–{_number(high)})"


def ways_of(result: DemoResult) -> tuple[Way, ...]:
    """Return all ways that were flown: the sources in the order of ψ*, then those without one."""
    flights, flown = result.flights, {flight.inverse: flight for flight in result.flown}
    ways = []
    for place, source in enumerate(flights.sources):
        name = f"{source.robot} ({'closest' if place == 0 else 'furthest'})"
        flight = flown.get(source.robot)
        ways.append(Way(name, source.rms_m, flight, source.psi, source.predicted_rms_m))
        if place == len(flights.sources) - 1 and (unguarded := result.unguarded) is not None:
            name, expected = f"{source.robot}, unguarded", source.predicted_rms_m
            ways.append(Way(name, unguarded.rms_m, unguarded, source.psi, expected, guarded=False))

    def add(label: str, name: str, found: InverseResult | None) -> None:
        if found is not None:
            ways.append(Way(name, found.rms_m, flown.get(label)))

    add(MIXTURE, "mixture of both", flights.mixture)
    add(NO_PRIOR, "none, but learning", flights.no_prior)
    add(OWN, "model of itself", flights.own)
    base = flights.baseline
    alone = "baseline alone"
    ways.append(Way(alone, base.rms_m, flown.get(BASELINE), None, base.predicted_rms_m))
    return tuple(ways)


def demo_parts(result: DemoResult) -> Iterator[RenderableType]:
    """Yield the table of all ways, the guard's reasons, and what to take away from them."""
    unit, base = f"m{result.flights.unit}", result.flights.baseline.rms_m
    ways = ways_of(result)
    table = Table(title=_title(result), title_justify="left")
    table.add_column("flown with", no_wrap=True)
    for heading in ("ψ*", f"predicted\n{unit}", f"flown\n{unit}", "less\nerror"):
        # On a narrow terminal only the interval of a prediction goes to a line of its own.
        table.add_column(heading, justify="right", no_wrap=not heading.startswith("predicted"))
    table.add_column("guard", no_wrap=True)
    for place, way in enumerate(ways):
        table.add_row(
            way.name,
            "" if way.psi is None else f"{way.psi:.4f}",
            way.predicted(),
            way.flown(),
            "" if way is ways[-1] or way.rms is None or not base else _less(way.rms, base),
            _guard(way),
            style="bold green" if place == 0 else None,
        )
    yield table
    for way in ways:
        if way.flight is not None and way.flight.taken_back is not None:
            yield f"the guard took {way.flight.inverse} back: {way.flight.taken_back}"
    yield takeaway(result)


def takeaway(result: DemoResult) -> str:
    """Return what a person should remember of a demonstration, as its numbers say."""
    unit, base = result.flights.unit, result.flights.baseline.rms_m
    ways = ways_of(result)
    best, worst = result.flights.sources[0], result.flights.sources[-1]
    harmful = next((way for way in ways if not way.guarded), None)
    harm = worst.rms_m if harmful is None else harmful.rms
    if best.rms_m is None or harm is None or not base:
        return "Not every flight was finished, so the ways cannot be compared."
    lesson = ""
    if harm > base:
        lesson = "Choose before you transfer: "
    elif harm < MATTERS * best.rms_m:
        lesson = "Here the choice matters little: "
    chose = f"{best.robot}, which the tests chose, left {_percent(best.rms_m, base)} of the"
    left, unless = "left", ""
    if harmful is not None:
        left, unless = "would have left", ", had the guard not intervened"
    parts = [
        f"{lesson}{chose} baseline's error; {worst.robot} {left} {_percent(harm, base)}{unless}."
    ]
    none = result.flights.no_prior.rms_m
    if none is not None and none > MATTERS * best.rms_m:
        parts.append(f"Learning in flight without experience left {_percent(none, base)}.")
    elif none is not None and none * MATTERS < best.rms_m:
        parts.append(f"No experience at all left less, {_percent(none, base)}.")
    finished = [way for way in ways if way.rms is not None]
    least = min(finished, key=lambda way: way.rms or 0.0)
    if least.rms is not None and least.rms * MATTERS < best.rms_m:
        known = _known(least, result.flights.target)
        parts.append(
            f"The least, {_number(least.rms)} m{unit}, was left by {_spoken(least, result)}{known}."
        )
    return " ".join(parts)


def _title(result: DemoResult) -> str:
    unit = result.flights.unit
    path = (f"{flight.drawing} at {flight.speed_m_s:g} {unit}/s, " for flight in result.flown)
    return f"effect of the transfer: {next(path, '')}in the predicted order"


def _guard(way: Way) -> str:
    if not way.guarded:
        return "off"
    return "" if way.taken_back is None else "withdrew"


def _spoken(way: Way, result: DemoResult) -> str:
    target = result.flights.target
    inverse = way.name if way.flight is None else way.flight.inverse
    without_source = {
        OWN: f"{target}'s model of itself",
        MIXTURE: "the mixture of the sources",
        NO_PRIOR: "no experience",
        BASELINE: f"{target}'s baseline controller",
    }
    return without_source.get(inverse, inverse)


def _known(way: Way, target: str) -> str:
    """Return what a model of itself cost the target."""
    flight = way.flight
    if flight is None or flight.inverse != OWN or flight.own_flight_s is None:
        return ""
    return f", which took {flight.own_flight_s:.0f} s of {target}'s own motion in these tests"


def _less(rms: float, base: float) -> str:
    return f"{100 * (1 - rms / base):.1f} %"


def _percent(rms: float, base: float) -> str:
    return f"{100 * rms / base:.0f} %"


def _number(value: float | None) -> str:
    if value is None:
        return ""
    thousandths = 1000 * value
    return f"{thousandths:.1f}" if thousandths >= 0.1 else f"{thousandths:.2g}"
