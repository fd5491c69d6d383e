"""The modes of the selection benchmark: verdicts against simulated transfers, stored sources."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.selection_families import LinearLoop, Mode
from benchmarks.selection_stored import outcome_of
from benchmarks.selection_stored import row_of as stored_row_of
from benchmarks.selection_verdicts import (
    judged,
    random_trajectory,
    row_of,
    through_inverse,
    tracking_error,
)
from nufleet.orchestrator.study.trajectory_spectrum import spectrum_of

SOURCE = LinearLoop((Mode(3.0, 0.6, 0.2), Mode(4.0, 0.1, gain=0.05)), 0.06)
TARGET = LinearLoop((Mode(2.0, 0.5),), 0.13)


def test_a_simulated_transfer_leaves_what_the_closed_form_says() -> None:
    wanted = random_trajectory(np.random.default_rng(0))
    spectrum = spectrum_of(wanted, 0.02)
    z_s, z_t = (loop.response(spectrum.omega_rad_s) for loop in (SOURCE, TARGET))
    for reference, left in ((wanted, 1 - z_t), (through_inverse(SOURCE, wanted), 1 - z_t / z_s)):
        expected = np.sqrt(spectrum.shares @ np.abs(left) ** 2)
        assert tracking_error(TARGET, reference, wanted) == pytest.approx(expected, rel=0.02)
    assert tracking_error(TARGET, through_inverse(TARGET, wanted), wanted) < 2e-3


def test_verdicts_are_counted_by_what_the_transfers_did() -> None:
    found = judged("second-order", 2, 0.003, 1, 0)
    assert len(found) == 4, "both directions of both sources"
    row = row_of("second-order", found)
    assert row.verdicts == 4
    assert row.harmful == sum(v.verdict == "transfer" and v.measured > v.baseline for v in found)
    assert row.given - round(row.right * row.given) == row.harmful + row.refused_wrongly
    assert row.error_off < 0.1


def test_with_stored_sources_only_the_target_flies() -> None:
    outcome = outcome_of("second-order", 6, 0.003, 1, 0)
    # A first look is 12.8 s of measuring, with two ramps and the settling time; a look at the lower
    # end of the band measures for longer.
    assert 12.8 * outcome.tests < outcome.flight_s < 40 * outcome.tests
    row = stored_row_of("second-order", [outcome])
    assert row.flight_mean_s == row.flight_worst_s == outcome.flight_s
