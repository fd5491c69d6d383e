"""`nufleet robot check` and `robot new`, as an author of a driver uses them."""

from __future__ import annotations

import importlib
import json
from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner, Result
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.robot_agent.driver_kit import subject_file
from nufleet.robot_agent.driver_kit.command import check, new
from nufleet.shared.robots.fleet_file import read_fleet_file, validated_settings
from nufleet.testing import assert_keeps_contract

INTEGRATOR = ["double_integrator", "--settings", "alpha = 0.9; beta = 0.003"]


def run(command: object, *words: str) -> Result:
    return CliRunner().invoke(command, list(words), catch_exceptions=True)  # type: ignore[arg-type]


def test_a_driver_is_checked_by_its_name_and_settings() -> None:
    result = run(check, *INTEGRATOR)
    assert result.exit_code == 0, result.output
    assert "ok   It rests at reference 0" in result.output
    assert "16 of 16 statements hold for double_integrator" in result.output


def test_a_robot_of_a_fleet_file_is_checked_as_json() -> None:
    result = run(check, "paper_linear", "--robot", "source-2", "--still", "--json")
    document = json.loads(result.output)
    assert (document["robot"], document["moved"]) == ("source-2", False)
    assert {one["holds"] for one in document["examined"]} == {True, None}


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["nothing_like_it"], "installed drivers: arm, coupled_loops, crazyflie"),
        (["double_integrator"], "alpha: missing"),
        (["double_integrator", "--settings", "alpha"], "is not TOML"),
        (["paper_linear", "--robot", "nobody"], "no robot 'nobody'"),
        (["paper_linear", "--settings", "alpha = 1.0"], "a fleet file has its own settings"),
    ],
)
def test_what_is_wrong_is_said_before_anything_moves(words: list[str], said: str) -> None:
    result = run(check, *words)
    assert result.exit_code != 0
    assert said in str(result.exception)


def test_a_real_robot_is_not_moved_without_consent(monkeypatch: pytest.MonkeyPatch) -> None:
    robot = PuppetRobot(puppet_spec(simulated=False))
    monkeypatch.setattr(subject_file, "build_robots", lambda *_: {"target": robot})
    result = run(check, "paper_linear")
    assert "give --yes to allow it, or --still to move nothing" in str(result.exception)
    assert not robot.connected
    run(check, "paper_linear", "--still")
    assert (robot.motions, robot.begun) == (0, 0)
    result = run(check, "paper_linear", "--yes")
    assert robot.motions > 0
    assert result.exit_code == 1  # a puppet keeps no time
    assert "Mend: Wait in `step`" in result.output


def test_a_new_package_keeps_the_contract_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = tmp_path / "package"
    result = run(new, "cart_of_mine", "--folder", str(folder))
    assert result.exit_code == 0, result.output
    assert "nufleet robot check cart_of_mine" in result.output
    monkeypatch.syspath_prepend(folder)
    driver = importlib.import_module("cart_of_mine.driver").DRIVER
    fleet = read_fleet_file(folder / "fleet.toml")
    for name, entry in fleet.robots.items():
        assert entry.driver == "cart_of_mine"
        settings = validated_settings(driver.settings, folder, name, entry.settings)
        assert_keeps_contract(driver.build({name: settings}, np.random.default_rng(0))[name])
    assert "NAME" not in "".join(
        path.read_text() for path in folder.rglob("*") if path.suffix in (".py", ".toml")
    )


def test_a_package_is_not_written_over_another_or_under_a_bad_name(tmp_path: Path) -> None:
    (tmp_path / "here").write_text("mine")
    for words, said in (
        (["cart", "--folder", str(tmp_path)], "exists already"),
        (["Cart-1", "--folder", str(tmp_path / "new")], "lower-case letter"),
        *(
            ([taken, "--folder", str(tmp_path / "new")], "has this name; add something to it")
            for taken in ("class", "types", "numpy", "nufleet", "crazyflie")
        ),
    ):
        result = run(new, *words)
        assert said in str(result.exception)
    assert [path.name for path in tmp_path.iterdir()] == ["here"]
