"""No user's identity reaches these tests, and none of their threads outlives them."""

from __future__ import annotations

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def _no_identity_of_the_user(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    for variable in ("NUFLEET_IDENTITY", "NUFLEET_ROUTER", "NUFLEET_OPEN", "NUFLEET_AUTHORITY"):
        monkeypatch.delenv(variable, raising=False)
