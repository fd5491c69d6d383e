"""Real robots move only after a person has agreed, whichever command asks them to."""

from __future__ import annotations

import json
from pathlib import Path

from command_processes import Typed
from fleet_lab import Lab
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.orchestrator.jobs.storage import Storage
from nufleet.shared.robots.health import Health
from nufleet.shared.robots.spec import TrackingLimits

LIMITS = TrackingLimits(
    position_max=2.0,
    speed_max=1.0,
    acceleration_max=2.0,
    correction_max=0.5,
    correction_speed_max=0.6,
)
COMMANDS = {
    "rank": ("--target", "a", "--band", "1", "20"),
    "match": ("--robot", "a", "--band", "1", "20"),
    "track": ("--target", "a", "--trajectory", "clover"),
    "train": ("--robot", "a", "--architecture", "preview"),
    "evaluate": ("--target", "a", "--architecture", "preview", "--quick"),
}


def test_no_command_moves_a_real_robot_where_no_person_can_be_asked(
    lab: Lab, endpoint: str, tmp_path: Path, typed: Typed
) -> None:
    changes = {"tracking": LIMITS, "omega_min_rad_s": 0.5, "omega_max_rad_s": 25.0}
    specs = {name: puppet_spec(simulated=name == "b").model_copy(update=changes) for name in "ab"}
    robots = {name: PuppetRobot(spec) for name, spec in specs.items()}
    for name, robot in robots.items():
        robot.reports = lambda: Health(battery=0.5, endurance_s=2000.0)
        lab.agent(name, robot)
    lab.orchestrator()
    for command, options in COMMANDS.items():
        asked = (command, "--connect", endpoint, *options)
        refused = typed(*asked, cwd=tmp_path)
        assert refused.returncode == 2, refused.stderr
        said = " ".join(refused.stderr.split())
        assert "a will really move" in said
        assert "no person is at the terminal to be asked: give --yes to allow it" in said
        planned = typed(*asked, "--plan", "--json", cwd=tmp_path)
        assert planned.returncode == 0, planned.stderr
        outlook = json.loads(planned.stdout)
        assert "a" in {one["robot"] for one in outlook["motions"]}
        assert all(robot["battery_used"] > 0 for robot in outlook["robots"])
    assert {robot.motions for robot in robots.values()} == {0}
    with Storage(tmp_path / "runs").open() as repository:
        assert not repository.studies.studies()
    assert not list(tmp_path.glob("runs/*/")), "a run that did not begin leaves no folder"


def test_simulated_robots_are_asked_about_where_that_is_wanted(
    lab: Lab, endpoint: str, tmp_path: Path, typed: Typed
) -> None:
    for name in ("a", "b"):
        lab.agent(name, PuppetRobot())
    lab.orchestrator()
    asked = ("rank", "--connect", endpoint, *COMMANDS["rank"], "--confirm")
    refused = typed(*asked, cwd=tmp_path)
    assert refused.returncode == 2
    assert "simulated robots will move" in refused.stderr
