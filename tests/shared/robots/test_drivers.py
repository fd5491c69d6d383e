"""Drivers: found by name, and said by name when they cannot be."""

from __future__ import annotations

from importlib.metadata import EntryPoint, EntryPoints
from pathlib import Path

import pytest

from nufleet.shared.errors import FleetFileError, InvalidInputError
from nufleet.shared.robots import drivers
from nufleet.shared.robots.drivers import (
    ENTRY_POINT_GROUP,
    check_settings,
    load_driver,
    needed_environment,
)
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file
from nufleet.sims.drivers import DOUBLE_INTEGRATOR
from nufleet.sims.fleets import ARMS, PAPER_QUADROTORS


def installed(monkeypatch: pytest.MonkeyPatch, **values: str) -> None:
    found = EntryPoints(
        EntryPoint(name, value, ENTRY_POINT_GROUP) for name, value in values.items()
    )
    monkeypatch.setattr(drivers, "installed", lambda group: {entry.name: entry for entry in found})


def fleet(tmp_path: Path, settings: str) -> tuple[FleetFile, Path]:
    path = tmp_path / "fleet.toml"
    path.write_text(
        'schema = 1\nname = "lab"\n[robots.a]\ndriver = "double_integrator"\n'
        f"settings = {settings}\n"
    )
    return read_fleet_file(path), path


def test_a_driver_is_found_by_its_name() -> None:
    assert load_driver("double_integrator") is DOUBLE_INTEGRATOR


def test_an_unknown_driver_is_named_with_those_there_are(monkeypatch: pytest.MonkeyPatch) -> None:
    installed(monkeypatch, b="x:y", a="x:y")
    with pytest.raises(FleetFileError, match="unknown driver 'c'; installed drivers: a, b"):
        load_driver("c")
    installed(monkeypatch)
    with pytest.raises(FleetFileError, match="installed drivers: none"):
        load_driver("c")


def test_a_driver_whose_needs_are_not_installed_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    installed(monkeypatch, arm="no_such_simulator.drivers:ARM")
    with pytest.raises(FleetFileError, match=r"driver 'arm' cannot be loaded: .*no_such_simulator"):
        load_driver("arm")


def test_settings_are_checked_before_anything_starts(tmp_path: Path) -> None:
    check_settings(*fleet(tmp_path, "{ alpha = 0.85, beta = 0.003 }"))
    with pytest.raises(FleetFileError, match=r"robots\.a\.settings: alhpa: unknown"):
        check_settings(*fleet(tmp_path, "{ alpha = 0.85, beta = 0.003, alhpa = 1.0 }"))


@pytest.mark.parametrize("fleet_file", [ARMS, PAPER_QUADROTORS])
def test_packages_that_are_missing_are_named_before_anything_starts(
    monkeypatch: pytest.MonkeyPatch, fleet_file: Path
) -> None:
    file = read_fleet_file(fleet_file)
    check_settings(file, fleet_file)
    monkeypatch.setattr(drivers, "find_spec", lambda package: None)
    with pytest.raises(InvalidInputError, match=r"need \w+ and \w+: pip install 'nufleet\["):
        check_settings(file, fleet_file)


def test_a_robot_without_wishes_needs_no_environment(tmp_path: Path) -> None:
    file, _ = fleet(tmp_path, "{ alpha = 0.85, beta = 0.003 }")
    assert needed_environment(file, ["a"]) == {}
