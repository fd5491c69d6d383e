"""Several experiences over the network: handed over, weighed in flight, shown, and put back."""

from __future__ import annotations

import threading
from io import StringIO
from pathlib import Path

import numpy as np
import pytest
from fleet_lab import Lab, double_integrator, refusal
from learned_things import experience, layout
from polling import PATIENCE_S
from rich.console import Console
from tracked_clover import tracked

from nufleet.orchestrator.evaluation.comparison import Psi, summarise
from nufleet.orchestrator.evaluation.fly_target import fly_target
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.prior_custody import install, prior_put_back
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.legs import Leg
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.jobs.transfer import TransferCommand, TransferResult, transfer
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.file import digest
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.wire.messages import TrackingTelemetry
from nufleet.shared.wire.motions import Way, Weighted

PATH = travel(np.array([[0.0], [0.9], [-0.5], [0.0]]), 0.4, 1.5, 0.015)
SOURCES = [
    experience("source-1", seed=1),
    experience("source-2", seed=2, layout=layout(horizon_samples=30)),
    experience("source-3", seed=3),
]


@pytest.fixture
def fleet(lab: Lab) -> Fleet:
    lab.agent("target", double_integrator(0.85, 1))
    return lab.orchestrator().fleet


def held(fleet: Fleet) -> list[str]:
    return [prior.manifest.robot for prior in fleet.describe("target").priors]


def give(fleet: Fleet) -> tuple[Weighted, ...]:
    for place, payload in enumerate(SOURCES):
        install(fleet, "target", "prior", payload, beside=place > 0)
    return tuple(Weighted(sha256=digest(payload), weight=0.25) for payload in SOURCES)


def test_a_robot_holds_several_priors_until_one_takes_their_place(fleet: Fleet) -> None:
    give(fleet)
    assert held(fleet) == ["source-1", "source-2", "source-3"]
    install(fleet, "target", "prior", SOURCES[1])
    assert held(fleet) == ["source-2"]
    give(fleet)
    fleet.remove_prior("target")
    assert held(fleet) == []


def test_priors_that_cannot_be_mixed_are_refused_when_they_come(fleet: Fleet) -> None:
    install(fleet, "target", "prior", SOURCES[0])
    other = experience("source-4", "state")
    install_beside = lambda: install(fleet, "target", "prior", other, beside=True)  # noqa: E731
    assert refusal(install_beside) == "misfit"
    assert held(fleet) == ["source-1"]


def test_the_weights_of_a_mixture_are_streamed_and_kept(fleet: Fleet) -> None:
    mixture, pilot = give(fleet), Pilot(fleet, "run")
    batches: list[TrackingTelemetry] = []
    ended = threading.Event()

    def on_telemetry(robot: str, telemetry: TrackingTelemetry) -> None:
        if not telemetry.experts:
            return  # the baseline's, some of which may come late
        batches.append(telemetry)
        if telemetry.first_sample + len(telemetry.desired) == len(PATH):
            ended.set()

    fleet.observe_tracking(on_telemetry)
    # From this flight its guard knows the baseline.
    pilot.along("target", Way(inverse="baseline"), PATH, "baseline")
    flight = pilot.along("target", Way(inverse="mixture", mixture=mixture), PATH, "mixture")
    assert flight.failure is None
    assert flight.details.experts == ("source-1", "source-2", "source-3")
    assert flight.details.weights is not None
    assert flight.details.weights.shape == (len(PATH), 4)
    np.testing.assert_allclose(flight.details.weights[0], 0.25)
    np.testing.assert_allclose(flight.details.weights.sum(axis=1), 1.0)
    assert ended.wait(PATIENCE_S)
    for batch in batches:
        assert batch.experts == flight.details.experts
        assert batch.weights is not None
        kept = flight.details.weights[batch.first_sample :][: len(batch.weights)]
        np.testing.assert_array_equal(batch.weights, kept)


def test_all_priors_are_put_back_in_their_order(fleet: Fleet) -> None:
    give(fleet)
    with prior_put_back(fleet, Pilot(fleet, "run"), fleet.describe("target")):
        install(fleet, "target", "prior", SOURCES[2])
    assert held(fleet) == ["source-1", "source-2", "source-3"]


def test_an_evaluation_flies_every_way_and_its_own_model_again_after_more_flying(
    sources: Fleet,
) -> None:
    before = experience("somebody", seed=9)
    install(sources, "target", "prior", before)
    pilot, target = Pilot(sources, "run"), sources.describe("target")
    # From this flight its guard knows the baseline.
    pilot.along("target", Way(inverse="baseline"), PATH, "baseline")
    names = ("source-1", "source-2", "source-3")
    psi = {"source-1": 0.1, "source-2": 0.2, "source-3": 0.4}
    flights = fly_target(
        sources,
        pilot,
        ExperienceLibrary(sources),
        target,
        names,
        [Leg("line", 0.4, "m", PATH)],
        "preview",
        guarded=True,
        observers=(),
        psi=psi,
        own_flight_s=(0.0, 5.0, 12.0),
    )
    assert [flight.inverse for flight in flights] == [
        *("own", "baseline", "none", "source-1", "source-2", "source-3", "mixture", "own", "own"),
    ]
    mixed = next(flight for flight in flights if flight.inverse == "mixture")
    assert mixed.weights is not None
    assert set(mixed.weights) == {*names, "none"}
    assert held(sources) == ["somebody"]
    estimates = {source: Psi(value, 0.01) for source, value in psi.items()}
    result = summarise("target", flights, estimates, "preview", unit="m", guarded=True, run="")
    assert result.mixture is not None
    assert result.mixture.rms_m == mixed.rms_m
    # Only its own rich flights taught it more about itself.
    beyond_s = [flight.beyond_tests_s for flight in flights]
    assert beyond_s == pytest.approx([0.0] * 7 + [5.0, 12.0], abs=0.1)
    known_s = [flight.own_flight_s for flight in flights]
    assert known_s[:7] == [known_s[0]] * 7
    assert known_s[7] != known_s[0]


def test_a_robot_forgets_what_it_knows_of_itself(fleet: Fleet) -> None:
    pilot = Pilot(fleet, "run")
    pilot.along("target", Way(inverse="baseline"), PATH, "baseline")
    assert fleet.describe("target").baseline_known
    fleet.forget_own_model("target")
    assert not fleet.describe("target").baseline_known
    assert refusal(lambda: pilot.along("target", Way(inverse="own"), PATH, "own")) == "no-own-model"


def transferred(
    lab: Lab, runs_root: Path, source: str, said: Console | None = None
) -> TransferResult:
    command = TransferCommand(
        connect=lab.endpoint,
        fleet_name=None,
        target="target",
        source=source,
        file=None,
        architecture=None,
        runs_root=runs_root,
        repository=None,
        as_json=False,
    )
    return transfer(command, said or Console(quiet=True))


@pytest.fixture
def sources(lab: Lab) -> Fleet:
    """Three that have an experience and one that has none, beside the target."""
    names = [f"source-{place}" for place in range(1, len(SOURCES) + 1)]
    for seed, name in enumerate(("target", *names, "novice")):
        lab.agent(name, double_integrator(0.9, seed))
    fleet = lab.orchestrator().fleet
    for name, payload in zip(names, SOURCES, strict=True):
        install(fleet, name, "experience", payload)
    return fleet


def test_all_that_have_an_experience_are_transferred_and_tracked_with(
    lab: Lab, sources: Fleet, tmp_path: Path
) -> None:
    given = transferred(lab, tmp_path, "all")
    assert given.source == "source-1"
    assert [each.source for each in given.companions] == ["source-2", "source-3"]
    assert held(sources) == ["source-1", "source-2", "source-3"]
    (flight,) = tracked(lab, tmp_path).flights
    assert (flight.inverse, flight.failure) == ("mixture", None)
    assert flight.weights is not None
    assert set(flight.weights) == {"source-1", "source-2", "source-3", "none"}
    assert sum(flight.weights.values()) == pytest.approx(1.0)
    # The paper's single prior stays a choice: it is the first of them.
    (single,) = tracked(lab, tmp_path, "prior").flights
    assert (single.inverse, single.weights) == ("source-1", None)


def test_named_sources_are_transferred_in_their_order_or_not_at_all(
    lab: Lab, sources: Fleet, tmp_path: Path
) -> None:
    transferred(lab, tmp_path, "source-3,source-1")
    assert held(sources) == ["source-3", "source-1"]
    with pytest.raises(InvalidInputError, match="novice"):
        transferred(lab, tmp_path, "source-2,novice")
    assert held(sources) == ["source-3", "source-1"]
    transferred(lab, tmp_path, "source-2")
    assert held(sources) == ["source-2"]


def test_a_transfer_says_that_a_source_which_no_ranking_chose_is_mixed_with_none(
    lab: Lab, tmp_path: Path
) -> None:
    for seed, name in enumerate(("target", "source-1")):
        lab.agent(name, double_integrator(0.9, seed))
    install(lab.orchestrator().fleet, "source-1", "experience", experience("source-1", "state"))
    said = StringIO()
    transferred(lab, tmp_path, "source-1", Console(file=said, width=200))
    assert (
        "no ranking chose source-1 for target, which mixes its experience with none"
        in said.getvalue()
    )
