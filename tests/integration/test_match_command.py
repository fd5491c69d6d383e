"""`nufleet match`: robots and simulators play the same tones, and the result is a number."""

from __future__ import annotations

from io import StringIO
from pathlib import Path

import pytest
from command_processes import Typed
from rich.console import Console

from nufleet.orchestrator.conduct.simulator_copy import SimulatorCopy
from nufleet.orchestrator.jobs.match import (
    MatchCommand,
    MatchResult,
    fitted,
    match,
    match_table,
)
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import read_fleet_file

FLEET = """
schema = 1
name = "lab"
[study]
target = "robot"
band_rad_s = [1.0, 8.0]
[robots.robot]
driver = "faulty"
settings.driver = "double_integrator"
settings.settings = { alpha = 0.9, beta = 0.003, noise_std_m = 0.001 }
settings.field = { delay_s = 0.02, jitter_s = 0.008, loss = 0.01, takes_off = true }
[robots.other]
driver = "double_integrator"
settings = { alpha = 1.0, beta = 0.003, noise_std_m = 0.001 }
[robots.twin]
driver = "double_integrator"
settings = { alpha = 0.9, beta = 0.003, noise_std_m = 0.001 }
"""


@pytest.fixture
def command(tmp_path: Path) -> MatchCommand:
    (tmp_path / "lab.toml").write_text(FLEET)
    return MatchCommand(
        runs_root=tmp_path / "runs",
        fleet_file=tmp_path / "lab.toml",
        draws=False,
        iterations=1,
        processes=1,
    )


def test_simulators_of_a_robot_behind_a_poor_link_are_told_apart_and_fitted(
    command: MatchCommand, tmp_path: Path
) -> None:
    result = match(command, Console(quiet=True))
    twin, other = result.simulators
    assert (result.robot, twin.simulator, other.simulator) == ("robot", "twin", "other")
    # The model of both is known: ψ* is 0.0450 at 4.65 rad/s, and 0 for the twin.
    assert twin.psi_low < 0.002
    assert twin.psi < 0.01
    assert other.psi_low < 0.0452
    assert other.psi_high > 0.0448
    assert 3.5 < other.omega_rad_s < 6.5  # the maximum is flat
    assert "softer" in other.words
    assert match_table(result).row_count == 2
    assert MatchResult.model_validate_json(result.document()) == result

    path = tmp_path / "lab.toml"
    copy = SimulatorCopy(read_fleet_file(path), path, "other", ["alpha"])
    shown = StringIO()
    found = fitted(command, result, copy, Console(file=shown, width=200))
    assert found.fit is not None
    assert abs(found.fit["alpha"].value / 0.9 - 1) < 0.05
    assert found.psi_left is not None
    assert found.psi_left < 0.01
    assert f"[robots.other.settings]\nalpha = {found.fit['alpha'].value:.5g}" in shown.getvalue()
    assert MatchResult.model_validate_json(found.document()) == found


def test_a_limit_that_is_no_distance_is_refused_before_anything_starts(
    command: MatchCommand,
) -> None:
    limited = MatchCommand(**{**vars(command), "psi_max": 1.5})
    with pytest.raises(InvalidInputError, match="--max is a chordal distance"):
        match(limited, Console(quiet=True))
    assert not command.runs_root.exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--fit", "alpha"), "--fit fits one simulator: choose one of other, twin"),
        (("--simulators", "twin", "--fit", "mass_kg"), "twin has no setting mass_kg; its settings"),
        (("--simulators", "twin", "--fit", "alpha,"), "has an empty name"),
    ],
)
def test_a_fit_that_cannot_be_made_is_refused_before_anything_starts(
    command: MatchCommand, tmp_path: Path, typed: Typed, options: tuple[str, ...], words: str
) -> None:
    refused = typed("match", "--fleet", "lab.toml", *options, cwd=tmp_path)
    assert refused.returncode == 2
    assert words in " ".join(refused.stderr.split())
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("robots", "options", "words"),
    [
        ("a b", (), "which robot are they to match? Name it with --robot; there are a, b"),
        ("a b", ("--robot", "a", "--simulators", "a"), "a is the robot, and cannot be among its"),
        ("a", ("--robot", "a"), "there is no simulator besides a in the fleet file"),
    ],
)
def test_a_match_of_nothing_is_refused_in_its_own_words(
    tmp_path: Path, typed: Typed, robots: str, options: tuple[str, ...], words: str
) -> None:
    own = 'driver = "double_integrator"\nsettings = { alpha = 0.9, beta = 0.003 }\n'
    tables = (f"[robots.{robot}]\n{own}" for robot in robots.split())
    (tmp_path / "two.toml").write_text("\n".join(['schema = 1\nname = "two"', *tables]))
    refused = typed("match", "--fleet", "two.toml", *options, cwd=tmp_path)
    assert refused.returncode == 2
    assert words in " ".join(refused.stderr.split())
