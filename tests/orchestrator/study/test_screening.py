"""What tones alone say of many sources: bounds that hold, and the ranking without them."""

from __future__ import annotations

from collections.abc import Mapping
from weakref import WeakSet

import numpy as np
import pytest
from random_loops import BAND, SPEC, Loop, answers

from nufleet.orchestrator.belief.loop_fit import Tones
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.orchestrator.study.adaptive_algorithm import AdaptiveStudy
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.interface import Report, StudyPlan
from nufleet.orchestrator.study.screening import Screened
from nufleet.orchestrator.study.selection_belief import SelectionBelief
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.distance.chordal import chordal_distance

GRID = np.linspace(*BAND, 256)
TONES = np.geomspace(2 * BAND[0], BAND[1], 9)


def loops(rng: np.random.Generator, count: int) -> dict[str, Loop]:
    return {
        name: Loop(
            rng.uniform(1.5, 5.0), damping=rng.uniform(0.4, 1.0), delay_s=rng.uniform(0.0, 0.15)
        )
        for name in ("target", *(f"source-{n}" for n in range(count)))
    }


def psi_star(fleet: dict[str, Loop], source: str) -> float:
    return float(chordal_distance(fleet["target"].z(GRID), fleet[source].z(GRID)).max())


def measured(loop: Loop, std: float, rng: np.random.Generator) -> Tones:
    error = rng.standard_normal((2, len(TONES))) * std / np.sqrt(2)
    return Tones(TONES, loop.z(TONES) + error[0] + 1j * error[1], np.full(len(TONES), std**2))


@pytest.mark.parametrize("std", [1e-4, 0.02, 0.3])
def test_no_source_is_closer_than_its_bound_however_noisy_its_tones_are(std: float) -> None:
    rng = np.random.default_rng(5)
    fleet = loops(rng, 400)
    sources = [name for name in fleet if name != "target"]
    target = np.tile(fleet["target"].z(GRID), (3, 1))
    screened = Screened.of(GRID, target, {n: measured(fleet[n], std, rng) for n in sources})
    truth = np.array([psi_star(fleet, name) for name in sources])
    # What a straight line between the frequencies of the grid leaves out.
    between = 1e-4
    assert np.all(screened.at_least <= truth[:, None] + between)
    if std < 1e-3:
        assert np.median(truth - screened.at_least[:, 0]) < 0.05, "the bound is of use"


def test_a_tone_outside_the_band_bounds_nothing() -> None:
    fleet = loops(np.random.default_rng(6), 1)
    above = np.array([2 * BAND[1]])
    tones = Tones(above, np.array([50.0 + 0j]), np.array([1e-6]))
    screened = Screened.of(GRID, np.tile(fleet["target"].z(GRID), (2, 1)), {"source-0": tones})
    assert np.all(screened.at_least == 0.0)


def test_only_a_source_that_every_sample_puts_behind_is_outrun() -> None:
    rng = np.random.default_rng(7)
    behind = 0.3 + 0.001 * rng.standard_normal(600)
    doubtful = 0.3 + 0.1 * rng.standard_normal(600)
    once_ahead = behind.copy()
    once_ahead[5] = 0.05
    at_least = np.stack([behind, doubtful, once_ahead])
    screened = Screened(("behind", "doubtful", "once ahead"), at_least, np.zeros(3), np.zeros(3))
    assert screened.outrun(np.full(600, 0.1)).tolist() == [True, False, False]


def ranked(fleet: dict[str, Loop], compared: int, std: float) -> tuple[Report, int, int]:
    """Return the last report, how many models were fitted, and how many were kept at once."""
    sources = tuple(name for name in fleet if name != "target")
    plan = StudyPlan("target", sources, BAND, 8, "x")
    settings = AdaptiveSettings(compared=compared)
    kept, alive, fitted = WeakSet[ResponseModel](), 0, 0
    original = ResponseModel.__init__

    def counted(self: ResponseModel, *args: object, **options: object) -> None:
        nonlocal alive, fitted
        original(self, *args, **options)  # type: ignore[arg-type]
        kept.add(self)
        alive, fitted = max(alive, len(kept)), fitted + 1

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ResponseModel, "__init__", counted)
        study = AdaptiveStudy(
            plan, dict.fromkeys(fleet, SPEC), np.random.default_rng(0), settings=settings
        )
        rng = np.random.default_rng(1)
        while (question := study.ask()) is not None:
            report = study.tell(answers(fleet, question, std, rng), {})
    return report, fitted, alive


@pytest.mark.thorough
def test_a_hundred_sources_are_ranked_by_fits_of_a_few() -> None:
    fleet = loops(np.random.default_rng(8), 100)
    report, fitted, _ = ranked(fleet, compared=8, std=0.01)
    everything, all_fitted, _ = ranked(fleet, compared=1000, std=0.01)
    assert all_fitted > 100
    assert fitted < 40
    truth = {name: psi_star(fleet, name) for name in fleet if name != "target"}
    assert report.selected == everything.selected
    assert truth[report.selected] < min(truth.values()) + 0.01
    assert report.confidence is not None
    assert report.confidence >= 0.95
    assert len(report.ranking) == 100, "every source is in the table"
    compared = {curve.source for curve in report.curves}
    assert len(compared) < 20
    for one in report.ranking:
        if one.robot not in compared:
            assert one.psi_low <= truth[one.robot] <= one.psi_high
            assert one.measured_psi is not None
            assert report.eliminated[one.robot].startswith("its tones alone put it 0.")
            assert truth[one.robot] > truth[report.selected]


@pytest.mark.thorough
def test_sources_that_tones_cannot_tell_apart_are_all_compared() -> None:
    rng = np.random.default_rng(9)
    fleet = {"target": Loop(3.0)} | {f"s-{n}": Loop(3.0 + 0.02 * rng.random()) for n in range(20)}
    report, *_ = ranked(fleet, compared=4, std=0.02)
    assert len(report.curves) == 20


@pytest.mark.thorough
def test_the_samples_of_few_sources_are_held_at_once_though_tones_leave_many_a_chance() -> None:
    fleet = loops(np.random.default_rng(10), 60)
    held: list[int] = []
    of = SelectionBelief.of

    def counted(
        omega: FloatArray, target: ComplexArray, sources: Mapping[str, ComplexArray]
    ) -> SelectionBelief:
        held.append(len(sources))
        return of(omega, target, sources)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(SelectionBelief, "of", lambda o, t, s, spectrum: counted(o, t, s))
        report, fitted, alive = ranked(fleet, compared=4, std=0.05)
    everything, *_ = ranked(fleet, compared=1000, std=0.05)
    assert fitted > 30, "tones alone do not tell the sources apart"
    assert max(held) < 25
    assert alive < 30
    assert report.selected == everything.selected
    assert len(report.ranking) == 60, "every source is in the table"
    truth = {name: psi_star(fleet, name) for name in fleet if name != "target"}
    compared = {curve.source for curve in report.curves}
    for one in report.ranking:
        if one.robot not in compared:
            assert one.psi_low <= truth[one.robot]
            assert report.eliminated[one.robot].startswith("its ")
            assert truth[one.robot] > truth[report.selected]
