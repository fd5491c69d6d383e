"""Numbers on the command line are finite and within their bounds, or refused in words."""

from __future__ import annotations

import click
import pytest
from click.testing import CliRunner
from hypothesis import given
from hypothesis import strategies as st

from nufleet.orchestrator.cli.types import PositiveNumber


def typed(text: str, *bounds: float) -> float:
    return PositiveNumber(*bounds).convert(text, None, None)


@given(st.floats(min_value=0.0, exclude_min=True, allow_nan=False, allow_infinity=False))
def test_a_number_is_taken_as_it_was_typed(number: float) -> None:
    assert typed(repr(number)) == number


@pytest.mark.parametrize("text", ["0", "-1", "nan", "inf", "-inf", "1e999", "0x10", "one", ""])
def test_what_is_no_finite_number_above_zero_is_refused(text: str) -> None:
    with pytest.raises(click.BadParameter):
        typed(text)


@given(st.floats(1e-6, 1e6))
def test_bounds_belong_to_what_is_allowed(number: float) -> None:
    if 60.0 <= number <= 600.0:
        assert typed(repr(number), 60.0, 600.0) == number
    else:
        with pytest.raises(click.BadParameter, match="between 60 and 600"):
            typed(repr(number), 60.0, 600.0)


def test_a_refusal_names_the_option() -> None:
    @click.command()
    @click.option("--speed", type=PositiveNumber())
    def fly(speed: float | None) -> None:
        """Fly."""

    result = CliRunner().invoke(fly, ["--speed", "nan"])
    assert result.exit_code == 2
    assert "'--speed': nan must be a number above 0, and finite" in result.output
    assert CliRunner().invoke(fly, []).exit_code == 0
