"""What tones alone say of many sources: bounds that hold, and the ranking without them."""

from __future__ import annotations

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


@pytest.mark.parametrize("std", [1e-4, 0.02])
def test_sources_are_as_far_away_as_at_their_tones_or_further(std: float) -> None:
    rng = np.random.default_rng(5)
    fleet = loops(rng, 400)
    sources = [name for name in fleet if name != "target"]
    target = np.tile(fleet["target"].z(GRID), (200, 1))
    known = {name: measured(fleet[name], std, rng) for name in sources}
    screened = Screened.of(GRID, target, known, rng)
    truth = np.array([psi_star(fleet, name) for name in sources])
    estimates = [screened.estimate(n, 1) for n in range(len(sources))]
    # What a straight line between the frequencies of the grid leaves out.
    between = 1e-4
    holds = [one.psi_low <= truth[n] + between for n, one in enumerate(estimates)]
    assert np.mean(holds) >= 0.975
    assert not screened.outrun(np.full(200, truth.min()))[np.argmin(truth)]
    if std < 1e-3:
        assert np.median(truth - screened.loss.mean(axis=1)) < 0.05, "tones are of use"


def test_a_tone_outside_the_band_bounds_nothing() -> None:
    rng = np.random.default_rng(6)
    fleet = loops(rng, 1)
    above = np.array([2 * BAND[1]])
    tones = {"source-0": Tones(above, np.array([50.0 + 0j]), np.array([1e-6]))}
    screened = Screened.of(GRID, np.tile(fleet["target"].z(GRID), (2, 1)), tones, rng)
    assert np.all(screened.loss == 0.0)


def test_noise_that_moves_a_source_away_in_every_sample_does_not_put_it_behind() -> None:
    rng = np.random.default_rng(7)
    fleet = loops(rng, 1)
    target = np.tile(fleet["target"].z(GRID), (600, 1))
    noisy = {"source-0": Tones(TONES, fleet["target"].z(TONES), np.full(len(TONES), 0.2**2))}
    screened = Screened.of(GRID, target, noisy, rng)
    assert np.all(screened.largest > 0.03)
    assert screened.ahead(np.full(600, 0.03))[0] > 0.3
    assert not screened.outrun(np.full(600, 0.03))[0]


def test_only_a_source_that_every_sample_puts_behind_is_outrun() -> None:
    rng = np.random.default_rng(7)
    behind = 0.3 + 0.001 * rng.standard_normal(600)
    doubtful = 0.3 + 0.1 * rng.standard_normal(600)
    once_ahead = behind.copy()
    once_ahead[5] = 0.05
    largest = np.stack([behind, doubtful, once_ahead])
    names = ("behind", "doubtful", "once ahead")
    screened = Screened(names, largest, np.median(largest, axis=1), np.zeros(3))
    assert screened.outrun(np.full(600, 0.1)).tolist() == [True, False, False]


def ranked(
    fleet: dict[str, Loop], compared: int, std: float, compared_max: int = 160
) -> tuple[Report, int, int]:
    """Return the last report, how many models were fitted, and how many were kept at once."""
    sources = tuple(name for name in fleet if name != "target")
    plan = StudyPlan("target", sources, BAND, 8, "x")
    settings = AdaptiveSettings(compared=compared, compared_max=compared_max)
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
def test_sources_that_tones_cannot_tell_apart_are_compared_between_them() -> None:
    rng = np.random.default_rng(9)
    fleet = {"target": Loop(3.0)} | {f"s-{n}": Loop(3.0 + 0.2 * rng.random()) for n in range(20)}
    report, *_ = ranked(fleet, compared=4, std=0.1)
    # Which of them noise puts out of reach depends on what was drawn: up to 8 of 20.
    assert len(report.curves) > 2 * 4, "others joined the first four, and more joined those"


@pytest.mark.thorough
def test_few_sources_are_compared_in_full_though_tones_leave_many_a_chance() -> None:
    fleet = loops(np.random.default_rng(10), 60)
    report, fitted, alive = ranked(fleet, compared=4, std=0.05, compared_max=12)
    everything, all_fitted, _ = ranked(fleet, compared=1000, std=0.05)
    assert len(report.curves) <= 12
    assert alive < 15
    assert fitted < 0.7 * all_fitted
    truth = {name: psi_star(fleet, name) for name in fleet if name != "target"}
    least = min(truth.values())
    assert truth[report.selected] - least < truth[everything.selected] - least + 0.01
    assert len(report.ranking) == 60, "every source is in the table"
    compared = {curve.source for curve in report.curves}
    for one in report.ranking:
        if one.robot not in compared and one.robot in report.eliminated:
            assert truth[one.robot] > truth[report.selected]


@pytest.mark.thorough
def test_sources_that_are_left_at_their_tones_are_no_claim_against_those_that_are_compared() -> (
    None
):
    rng = np.random.default_rng(11)
    fleet = {"target": Loop(3.0)} | {f"s-{n}": Loop(3.0 + 0.02 * rng.random()) for n in range(20)}
    report, *_ = ranked(fleet, compared=4, std=0.1, compared_max=4)
    assert (report.confidence or 0.0) < 0.95
    assert len(report.curves) == 4
    assert not set(report.eliminated) - {curve.source for curve in report.curves}
    assert any("more sources may be as close as" in finding for finding in report.findings)
