"""What evaluations found: flights with each prior, and targets with the errors of every source."""

from __future__ import annotations

from nufleet.orchestrator.evaluation.comparison import Psi, summarise
from nufleet.orchestrator.evaluation.results import (
    BaselineResult,
    EvaluationResult,
    FlightRecord,
    InverseResult,
    SourceResult,
)
from nufleet.orchestrator.flights.labels import BASELINE, NO_PRIOR, OWN
from nufleet.shared.experience.layout import Architecture

PSI = {"near": Psi(0.1, 0.01), "middle": Psi(0.3, 0.02), "far": Psi(0.5, 0.03)}
ERRORS = {BASELINE: (0.2, 0.4), NO_PRIOR: (0.25, 0.25), "near": (0.05, 0.07)}
ERRORS |= {"middle": (0.1, 0.2), "far": (0.3, 0.1)}


def record(
    inverse: str, drawing: str, rms_m: float | None, *, taken_back: str | None = None
) -> FlightRecord:
    return FlightRecord(
        target="target",
        inverse=inverse,
        drawing=drawing,
        speed_m_s=0.6,
        rms_m=rms_m,
        taken_back=taken_back,
        failure="it fell over" if rms_m is None else None,
        deadline_misses=0,
    )


def records(errors: dict[str, tuple[float | None, float | None]]) -> list[FlightRecord]:
    return [
        record(inverse, drawing, rms_m)
        for inverse, both in errors.items()
        for drawing, rms_m in zip(("clover", "pear"), both, strict=True)
    ]


def summed(
    flights: list[FlightRecord], psi: dict[str, Psi] | None = None, unit: str = "m"
) -> EvaluationResult:
    return summarise("target", flights, psi or PSI, "state", unit=unit, guarded=True, run="runs/1")


Predicted = tuple[float, float, float]


def predicted(flights: list[FlightRecord], of: dict[str, Predicted]) -> list[FlightRecord]:
    """Give the flights of some ways their predictions: low, median, high."""
    names = ("predicted_low_m", "predicted_rms_m", "predicted_high_m")
    return [
        f.model_copy(update=dict(zip(names, of[f.inverse], strict=True))) if f.inverse in of else f
        for f in flights
    ]


def after(own_s: float, flights: list[FlightRecord]) -> list[FlightRecord]:
    return [f.model_copy(update={"beyond_tests_s": own_s}) for f in flights]


# The predictions like "near" best after the tests, where "own" is better, and "own" afterwards.
FIRST = predicted(
    records({**ERRORS, OWN: (0.03, 0.05)}),
    {
        BASELINE: (0.25, 0.3, 0.35),
        NO_PRIOR: (0.1, 0.2, 0.3),
        "near": (0.04, 0.06, 0.08),
        OWN: (0.02, 0.1, 0.3),
    },
)
LATER = after(15.0, predicted(records({OWN: (0.01, 0.03)}), {OWN: (0.01, 0.02, 0.025)}))


STATE: Architecture = "state"


def target(
    name: str, base: float | None, sources: dict[str, tuple[float, float | None]]
) -> EvaluationResult:
    """A target's result from each source's (ψ, error); the errors are on one path."""
    ordered = sorted(sources.items(), key=lambda item: item[1][0])
    return EvaluationResult(
        target=name,
        architecture=STATE,
        unit="m",
        guarded=True,
        baseline=BaselineResult(rms_m=base),
        no_prior=InverseResult(rms_m=None, reduction_percent=None),
        sources=tuple(
            SourceResult(
                robot=source,
                psi=psi,
                psi_std=0.0,
                rms_m=rms_m,
                reduction_percent=None,
                worst_ratio=None if rms_m is None or base is None else rms_m / base,
            )
            for source, (psi, rms_m) in ordered
        ),
        selected=ordered[0][0],
        kendall_tau=None,
        run="runs/1",
    )


A = target("a", 0.2, {"b": (0.1, 0.04), "c": (0.3, 0.1)})
B = target("b", 0.1, {"a": (0.1, 0.06), "c": (0.2, 0.02)})
C = target("c", 0.4, {"a": (0.3, 0.6), "b": (0.2, 0.2)})
