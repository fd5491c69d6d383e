"""What `nufleet gap` reports of two models, and how it was computed."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from random_models import random_quotient
from rich.console import Console

from nufleet.orchestrator.gap.report import GapReport, gap_report, gap_table
from nufleet.shared.distance.nu_gap import nu_gap
from nufleet.shared.models.realization import transfer_function
from nufleet.shared.models.transfer_models import ModelError


def reported(folder: Path, *documents: dict[str, object]) -> GapReport:
    paths = [folder / f"model-{place}.json" for place in range(2)]
    for path, document in zip(paths, documents, strict=True):
        path.write_text(json.dumps(document))
    return gap_report(*paths, None, None)


def fraction(num: object, den: object, dt: float = 0.0) -> dict[str, object]:
    return {"num": np.asarray(num).tolist(), "den": np.asarray(den).tolist(), "dt": dt}


def matrices(num: object, den: object, dt: float = 0.0) -> dict[str, object]:
    model = transfer_function(np.asarray(num), np.asarray(den), dt)
    return {name.upper(): getattr(model, name).tolist() for name in "abcd"} | {"dt": dt}


@pytest.mark.parametrize("dt_s", [0.0, 0.02])
def test_two_transfer_functions_are_compared_by_their_polynomials(
    tmp_path: Path, dt_s: float
) -> None:
    rng = np.random.default_rng(8)
    for _ in range(5):
        first, second = random_quotient(rng, dt_s), random_quotient(rng, dt_s)
        found = reported(tmp_path, fraction(*first, dt_s), fraction(*second, dt_s))
        expected = nu_gap(transfer_function(*first, dt_s), transfer_function(*second, dt_s))
        assert found.computed_from == "polynomials"
        assert found.nu_gap == pytest.approx(expected.value, abs=1e-7)
        assert found.winding_condition is not None
        assert found.winding_condition.holds == expected.winding_ok
        assert found.winding_condition.poles_unstable == expected.poles_unstable


def test_any_other_pair_is_compared_by_its_matrices(tmp_path: Path) -> None:
    first, second = ([1], [1, 1]), ([2], [1, 1])
    for described in ((matrices, matrices), (matrices, fraction), (fraction, matrices)):
        documents = (describe(*p) for describe, p in zip(described, (first, second), strict=True))
        found = reported(tmp_path, *documents)
        assert found.computed_from == "matrices"
        assert found.nu_gap == pytest.approx(1 / 3)


def test_the_table_says_what_the_gap_was_computed_from(tmp_path: Path) -> None:
    console = Console(width=120)
    for describe, words in ((fraction, "polynomials of both"), (matrices, "matrices of both")):
        with console.capture() as captured:
            report = reported(tmp_path, describe([1], [1, 1]), describe([1], [1, 2]))
            console.print(gap_table(report))
        assert words in captured.get()


def test_transfer_functions_of_different_sample_times_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="differ in sample time"):
        reported(tmp_path, fraction([1], [1, 0.5], 0.1), fraction([1], [1, 0.5], 0.2))
