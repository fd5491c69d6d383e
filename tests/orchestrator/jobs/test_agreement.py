"""Whether robots may move: who is asked, and what is worked out for nothing."""

from __future__ import annotations

import io
from pathlib import Path

import click
import pytest
from puppet_robot import puppet_spec
from rich.console import Console

from nufleet.orchestrator.flights.planned import Outlook, PlannedMotion
from nufleet.orchestrator.jobs.commands import MovingCommand, StoredCommand
from nufleet.orchestrator.jobs.consent import Moves, OnlyPlannedError, agree, only_simulated
from nufleet.shared import command_line
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.health import Health
from nufleet.shared.wire.messages import Description

REAL = Description(robot="a", boot_id="1", spec=puppet_spec(simulated=False))
SIMULATED = Description(robot="a", boot_id="1", spec=puppet_spec())
MOTION = PlannedMotion(
    robot="a",
    simulated=False,
    what="tones",
    duration_s=9.0,
    unit="m",
    low={"x": -0.1},
    high={"x": 0.1},
    velocity=1.0,
    acceleration=1.0,
    measured={"x": (None, None)},
)


def agreed(
    robot: Description,
    moves: Moves,
    command: StoredCommand | None = None,
    health: Health | None = None,
) -> str:
    said = io.StringIO()
    wanted = command or MovingCommand(runs_root=Path("runs"))
    agree(wanted, [robot], moves, lambda robot: health, Console(file=said, width=200))
    return said.getvalue()


def outlook() -> Outlook:
    return Outlook(headline="a plan", motions=(MOTION,))


def command(**options: object) -> MovingCommand:
    return MovingCommand(**{"runs_root": Path("runs"), **options})  # type: ignore[arg-type]


def someone_says(answer: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command_line.sys, "stdin", io.StringIO(answer))
    monkeypatch.setattr(command_line.sys.stdin, "isatty", lambda: True)
    monkeypatch.setattr(click, "confirm", lambda *_, **__: _decided(answer))


def _decided(answer: str) -> None:
    if answer != "y":
        raise click.Abort


def test_a_person_is_shown_the_plan_and_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    someone_says("y", monkeypatch)
    assert "a plan" in agreed(REAL, outlook)
    someone_says("n", monkeypatch)
    with pytest.raises(click.Abort):
        agreed(REAL, outlook)
    with pytest.raises(click.Abort):
        agreed(SIMULATED, outlook, command(yes=False))


def test_scripts_agree_beforehand_and_see_the_plan() -> None:
    assert "a plan" in agreed(REAL, outlook, command(yes=True))


def test_nothing_is_worked_out_where_simulated_robots_or_none_move() -> None:
    assert agreed(SIMULATED, only_simulated) == ""
    assert agreed(REAL, None) == ""


def test_a_command_for_simulated_robots_does_not_move_real_ones() -> None:
    with pytest.raises(InvalidInputError, match="simulated robots only; nothing has moved"):
        agreed(REAL, only_simulated, StoredCommand(runs_root=Path("runs")))


def test_a_plan_ends_the_command_before_its_robots_move() -> None:
    with pytest.raises(OnlyPlannedError) as planned:
        agreed(SIMULATED, outlook, command(plans=True), Health(battery=0.5, endurance_s=90.0))
    (robot,) = planned.value.outlook.robots
    assert robot.battery_used == pytest.approx(0.05)


def test_a_robot_that_is_not_ready_is_named_before_anybody_is_asked() -> None:
    with pytest.raises(InvalidInputError, match="a is not ready: no fix; nothing has moved"):
        agreed(REAL, outlook, health=Health(ready=False, reason="no fix"))
