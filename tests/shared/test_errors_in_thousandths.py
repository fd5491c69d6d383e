"""Errors are printed in millimetres or milliradians everywhere, and in metres from one metre on."""

from __future__ import annotations

import pytest

from nufleet.shared.text import in_thousandths


@pytest.mark.parametrize(
    ("error", "unit", "shown"),
    [
        (0.000591, "rad", "0.591 mrad"),
        (0.0051, "m", "5.1 mm"),
        (0.99949, "m", "999 mm"),
        (0.9995, "m", "1 m"),
        (1.234, "m", "1.23 m"),
        (0.0, "m", "0 mm"),
    ],
)
def test_an_error_is_shown_in_thousandths_of_its_unit(error: float, unit: str, shown: str) -> None:
    assert in_thousandths(error, unit) == shown
