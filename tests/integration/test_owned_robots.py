"""Every command that moves robots leaves alone those that another orchestrator owns."""

from __future__ import annotations

from pathlib import Path

from command_processes import Typed
from fleet_lab import Lab, double_integrator

from nufleet.orchestrator.conduct.leases import hold_leases
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.shared.wire.messages import RobotStatus

COMMANDS = {
    "rank": ("--target", "a", "--band", "2", "10"),
    "train": ("--robot", "a"),
    "transfer": ("--target", "a", "--source", "none"),
    "track": ("--target", "a", "--trajectory", "clover"),
    "evaluate": ("--target", "a", "--quick"),
}


def test_a_robot_that_is_owned_is_left_alone_by_every_command_and_by_none_afterwards(
    lab: Lab, tmp_path: Path, typed: Typed
) -> None:
    for seed, name in enumerate(("a", "b")):
        lab.agent(name, double_integrator(0.9, seed))
    watcher = lab.orchestrator()
    runs = tmp_path / "runs"
    runs.mkdir()
    with open_repository(str(runs / "nufleet.sqlite")) as repository:
        with hold_leases(repository.leases, "lab", ("a",), owner="somebody"):
            for command, arguments in COMMANDS.items():
                done = typed(command, "--connect", lab.endpoint, *arguments, cwd=tmp_path)
                assert done.returncode == 1, command
                assert "robot a is owned by somebody (epoch 1)" in done.stderr, command
                assert not list(runs.glob("*/")), command
            # Who only looks is free.
            status = typed("fleet", "status", "--connect", lab.endpoint, cwd=tmp_path)
            assert status.returncode == 0
        state = watcher.state("a", lambda state: state.status is RobotStatus.IDLE)
        assert state.last_goal_id is None
        arguments = ("--connect", lab.endpoint, *COMMANDS["transfer"])
        assert typed("transfer", *arguments, cwd=tmp_path).returncode == 0
        assert not repository.leases.held("lab")
        assert watcher.fleet.describe("a").epoch == 2
