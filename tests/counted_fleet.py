"""Counts what a command asks for, to show that nothing is read or asked twice."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import pytest

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.shared.wire.messages import Description


@dataclass
class Counted:
    """How often fleet files were read in this process, and each robot was asked to describe itself.

    The robots' own processes read their file themselves, and are not counted.
    """

    files: int = 0
    descriptions: Counter[str] = field(default_factory=Counter)

    @classmethod
    def begun(cls, monkeypatch: pytest.MonkeyPatch) -> Counted:
        """Count from now on."""
        found = cls()
        validate, describe = FleetFile.model_validate_json, Fleet.describe

        def validated(text: str) -> FleetFile:
            found.files += 1
            return validate(text)

        def described(fleet: Fleet, robot: str) -> Description:
            found.descriptions[robot] += 1
            return describe(fleet, robot)

        monkeypatch.setattr(FleetFile, "model_validate_json", validated)
        monkeypatch.setattr(Fleet, "describe", described)
        return found
