"""The whole workflow on one drawing: rank, learn, transfer, track, compare with the prediction."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from rich.table import Table

from nufleet.orchestrator.evaluation.flight_documents import DEMONSTRATION, DemoResult
from nufleet.orchestrator.evaluation.fly_target import FlightObserver, Psi, fly_target, summarise
from nufleet.orchestrator.evaluation.results import EvaluationResult
from nufleet.orchestrator.experience.learning import know_itself
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.train import train_robots
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description


def demonstrate(
    fleet: Fleet,
    pilot: Pilot,
    target: Description,
    ranking: RankResult,
    legs: Sequence[Leg],
    architecture: Architecture,
    folder: RunFolder,
    *,
    seed: int,
    flight_s: float,
    say: Callable[[str], None],
    observers: Sequence[FlightObserver],
) -> DemoResult:
    """Have the closest and the furthest source learn, and fly the target with each experience.

    Args:
        fleet: Client of the fleet, already connected.
        pilot: Pilot that has the robots fly.
        target: Description of the robot that needs experience.
        ranking: Ranking of the sources by frequency tests; the closest comes first.
        legs: Paths that the target flies with every inverse.
        architecture: Architecture of the experiences that the sources learn.
        folder: Folder of the run; experiences and the result are written there.
        seed: Seed of the learning flights and of the networks' first weights.
        flight_s: Duration in s of each flight that a robot learns from.
        say: Callback that receives one line of progress at a time.
        observers: Callbacks for the beginning and the end of each flight along a path.

    Returns:
        The ranking together with the errors of the flights, as written to the run's folder.
    """
    best, worst = ranking.ranking[0], ranking.ranking[-1]
    chosen = list(dict.fromkeys((best.robot, worst.robot)))
    say(f"{' and '.join(chosen)} fly for {flight_s:.0f} s to learn")
    know_itself(fleet, pilot, target.robot, seed=seed, say=say)
    train_robots(
        fleet,
        pilot,
        [fleet.describe(source) for source in chosen],
        (architecture,),
        folder.path / "experiences",
        seed=seed,
        duration_s=flight_s,
        say=lambda robot, what: None,
        on_trained=lambda done: say(
            f"  {done.lesson.robot} offers its experience: a network with a horizon of "
            f"{done.lesson.choice.layout.horizon_s:.2f} s, trained in {done.training_time_s:.1f} s"
        ),
    )
    say(f"{target.robot} tracks a drawing with each of them as its prior")
    flights = fly_target(
        fleet,
        pilot,
        ExperienceLibrary(fleet),
        target,
        chosen,
        legs,
        architecture,
        guarded=True,
        observers=observers,
        psi={estimate.robot: estimate.psi for estimate in (best, worst)},
    )
    result = DemoResult(
        ranking=ranking,
        flights=summarise(
            target.robot,
            flights,
            {estimate.robot: Psi(estimate.psi, estimate.psi_std) for estimate in (best, worst)},
            architecture,
            unit=target.spec.axes[0].unit,
            guarded=True,
            run=str(folder.path),
        ),
        run=str(folder.path),
    )
    folder.write_document(DEMONSTRATION, result)
    return result


def demo_table(result: EvaluationResult) -> Table:
    """Return a table of the errors, in the order that the tests predicted."""
    table = Table(title="effect of the transfer, in the predicted order", title_justify="left")
    table.add_column("prior")
    for heading in ("predicted ψ*", f"RMS error, m{result.unit}", "less error"):
        table.add_column(heading, justify="right")
    for place, source in enumerate(result.sources):
        table.add_row(
            f"{source.robot} ({'closest' if place == 0 else 'furthest'})",
            f"{source.psi:.4f}",
            _milli(source.rms_m),
            _percent(source.reduction_percent),
            style="bold green" if place == 0 else None,
        )
    if result.mixture is not None:
        mixed = result.mixture
        table.add_row(
            "both, weighed in flight", "", _milli(mixed.rms_m), _percent(mixed.reduction_percent)
        )
    none = result.no_prior
    table.add_row(
        "none: learns in flight", "", _milli(none.rms_m), _percent(none.reduction_percent)
    )
    if result.own is not None:
        own = result.own
        table.add_row("own model of itself", "", _milli(own.rms_m), _percent(own.reduction_percent))
    table.add_row("baseline controller alone", "", _milli(result.baseline.rms_m), "")
    return table


def _milli(value: float | None) -> str:
    return "not finished" if value is None else f"{1000 * value:.1f}"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.1f} %"
