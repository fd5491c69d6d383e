"""What `make check` runs is told from what tests import."""

from __future__ import annotations

from pathlib import Path

import pytest
from purity import TESTS, is_pure


@pytest.mark.parametrize(
    "pure",
    [
        "robot_agent/rules/test_supervisor.py",
        "shared/wire/test_codec.py",
        "orchestrator/study/test_selection_belief.py",
    ],
)
def test_what_computes_is_pure(pure: str) -> None:
    assert is_pure(TESTS / pure)


@pytest.mark.parametrize(
    "impure",
    [
        "shared/wire/test_transport.py",  # imports it
        "integration/test_epochs.py",  # through a helper
        "orchestrator/repository/test_repository_studies.py",  # through its folder's conftest.py
        "sims/quadrotors/test_quadrotor_flight.py",
        "faults/test_chaos.py",
    ],
)
def test_what_reaches_out_is_not(impure: str) -> None:
    assert not is_pure(TESTS / impure)


def test_every_package_has_pure_tests() -> None:
    pure = {path.relative_to(TESTS).parts[0] for path in TESTS.rglob("test_*.py") if is_pure(path)}
    assert {"orchestrator", "robot_agent", "shared", "sims"} <= pure


@pytest.mark.parametrize(
    ("text", "pure"),
    [
        ("import socketry\nfrom shared.transporter import open_client", True),
        ("from nufleet.shared.wire import transport", False),
        ("def test():\n    import jax.numpy", False),
    ],
)
def test_names_are_told_apart_wherever_they_are_imported(
    text: str, pure: bool, tmp_path: Path
) -> None:
    module = tmp_path / "test_it.py"
    module.write_text(text)
    assert is_pure(module) is pure
