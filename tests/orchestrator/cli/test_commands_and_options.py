"""Options are said once: each command's are the fields of its job, and reach it converted."""

from __future__ import annotations

from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import click
import pytest
from click.testing import CliRunner, Result

from nufleet.orchestrator.cli.demo import demo
from nufleet.orchestrator.cli.evaluate import evaluate
from nufleet.orchestrator.cli.import_flight import import_flight
from nufleet.orchestrator.cli.match import match
from nufleet.orchestrator.cli.rank import rank
from nufleet.orchestrator.cli.runs import prune, resume
from nufleet.orchestrator.cli.track import track
from nufleet.orchestrator.cli.train import train
from nufleet.orchestrator.cli.transfer import transfer
from nufleet.orchestrator.jobs.demo import DemoCommand
from nufleet.orchestrator.jobs.evaluate import EvaluateCommand
from nufleet.orchestrator.jobs.import_flight import ImportCommand
from nufleet.orchestrator.jobs.match import MatchCommand
from nufleet.orchestrator.jobs.prune import PruneCommand
from nufleet.orchestrator.jobs.rank import RankCommand
from nufleet.orchestrator.jobs.resume import ResumeCommand
from nufleet.orchestrator.jobs.track import TrackCommand
from nufleet.orchestrator.jobs.train import TrainCommand
from nufleet.orchestrator.jobs.transfer import TransferCommand
from nufleet.shared.command_line import command_line
from nufleet.shared.errors import FleetFileError
from nufleet.shared.wire.identity import IdentityError
from nufleet.sims.fleets import PAPER_LINEAR

JOBS: dict[str, tuple[click.Command, type[Any]]] = {
    "rank": (rank, RankCommand),
    "train": (train, TrainCommand),
    "track": (track, TrackCommand),
    "transfer": (transfer, TransferCommand),
    "evaluate": (evaluate, EvaluateCommand),
    "demo": (demo, DemoCommand),
    "resume": (resume, ResumeCommand),
    "prune": (prune, PruneCommand),
}
COMMANDS = {name: command for name, (command, _) in JOBS.items()} | {"match": match}


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """What the jobs were asked for, since none of them is done."""
    found: list[Any] = []

    def asked(command: Any) -> bool:
        found.append(command)
        return True

    for name in COMMANDS:
        monkeypatch.setattr(f"nufleet.orchestrator.jobs.{name}.{name}_and_print", asked)
    for variable in ("NUFLEET_ROUTER", "NUFLEET_IDENTITY", "NUFLEET_RUNS", "NUFLEET_REPOSITORY"):
        monkeypatch.delenv(variable, raising=False)
    monkeypatch.setenv("XDG_CONFIG_HOME", "/nonexistent")
    return found


def typed(name: str, *arguments: str, **environment: str) -> Result:
    return CliRunner().invoke(COMMANDS[name], arguments, env=environment)


@pytest.mark.parametrize("name", JOBS)
def test_the_options_of_a_command_are_the_fields_of_its_job(name: str) -> None:
    command, job = JOBS[name]
    options = {parameter.name for parameter in command.params}
    # `rank --resume` is another job; how many processes a fleet gets only scripts choose; and the
    # address of the fleet is chosen before the job begins.
    taken = {field.name for field in fields(job)}
    assert options - {"resume", "identity", "allow_open"} == taken - {"processes"}


@pytest.mark.parametrize(
    ("command", "job", "others"),
    [(match, MatchCommand, set()), (import_flight, ImportCommand, {"lists"})],
    ids=["match", "import"],
)
def test_every_option_of_a_command_is_a_field_of_a_job_that_has_more(
    command: click.Command, job: type[Any], others: set[str]
) -> None:
    options = {parameter.name for parameter in command.params}
    # `import --list` is another job.
    taken = {field.name for field in fields(job)}
    assert options - {"identity", "allow_open"} - others <= taken


@pytest.mark.parametrize("name", ["rank", "resume", "prune"])
def test_options_that_are_left_out_are_what_the_job_takes_by_default(
    name: str, asked: list[Any]
) -> None:
    assert typed(name).exit_code == 0
    assert asked == [JOBS[name][1](runs_root=Path("runs"))]


def test_a_fleet_that_is_started_for_the_command_needs_no_identity(
    asked: list[Any], tmp_path: Path
) -> None:
    folder = tmp_path / "nufleet"
    folder.mkdir()
    for name in ("anna", "desk"):
        (folder / f"{name}.nufleet").touch()
    mine = {"XDG_CONFIG_HOME": str(tmp_path)}
    assert typed("rank", "--fleet", "paper_linear", **mine).exit_code == 0
    assert len(asked) == 1
    which = typed("rank", **mine).exception
    assert isinstance(which, IdentityError)
    chosen = folder / "anna.nufleet"
    assert typed("rank", "--identity", str(chosen), **mine).exit_code == 0
    assert asked[-1].connect == f"identity/{chosen}"


def test_options_of_rank_reach_the_job_converted(asked: list[Any]) -> None:
    arguments = (
        *("--fleet", "paper_linear", "--sources", "a,b", "--band", "0.5", "10", "--reuse"),
        *("--seed", "3", "--realtime", "4", "--json", "--runs", "here"),
    )
    assert typed("rank", *arguments).exit_code == 0
    assert asked == [
        RankCommand(
            fleet_file=PAPER_LINEAR,
            sources=("a", "b"),
            band_rad_s=(0.5, 10.0),
            reuse_days=30.0,
            seed=3,
            realtime=4.0,
            as_json=True,
            runs_root=Path("here"),
        )
    ]


def test_options_of_evaluate_reach_the_job_converted(asked: list[Any]) -> None:
    arguments = ("--drawings", "clover,my drawing.csv", "--speeds", "0.3,0.6", "--no-guard")
    assert typed("evaluate", *arguments).exit_code == 0
    (command,) = asked
    assert command.drawings == ("clover", "my drawing.csv")
    assert command.speeds == (0.3, 0.6)
    assert (command.sources, command.fleet_file, command.guarded) == (None, None, False)


def test_options_that_say_no_turn_something_off(asked: list[Any]) -> None:
    flight = ("--target", "a", "--trajectory", "clover", "--trajectory", "pear")
    assert typed("track", *flight).exit_code == 0
    assert typed("track", *flight, "--no-learning", "--no-guard").exit_code == 0
    as_usual, otherwise = asked
    assert (as_usual.learn, as_usual.guarded) == (True, True)
    assert (otherwise.learn, otherwise.guarded) == (False, False)
    assert otherwise.drawings == ("clover", "pear")


@pytest.mark.parametrize(
    ("chosen", "architectures"),
    [("state", ("state",)), ("preview", ("preview",)), ("both", ("state", "preview"))],
)
def test_both_architectures_can_be_trained_at_once(
    chosen: str, architectures: tuple[str, ...], asked: list[Any]
) -> None:
    assert typed("train", "--architecture", chosen).exit_code == 0
    assert asked[0].architectures == architectures


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "give either --source or --file"),
        (("--source", "b", "--file", "b.safetensors"), "give either --source or --file"),
        (("--file", "b.safetensors", "--architecture", "state"), "only one experience"),
    ],
)
def test_a_transfer_takes_one_experience(
    arguments: tuple[str, ...], words: str, asked: list[Any]
) -> None:
    refused = typed("transfer", "--target", "a", *arguments)
    assert (refused.exit_code, asked) == (2, [])
    assert words in refused.output


FLIGHT = ("--target", "a", "--trajectory", "clover")


@pytest.mark.parametrize(
    ("name", "arguments", "words"),
    [
        ("rank", ("--fleet", "paper_linear", "--connect", "tcp/127.0.0.1:1"), "--connect has no"),
        ("rank", ("--fleet", "paper_linear", "--wait", "3"), "effect with --fleet, which starts"),
        ("evaluate", ("--fleet", "paper_linear", "--fleet-name", "lab"), "--fleet-name has no"),
        ("rank", ("--realtime", "1"), "--realtime has no effect without --fleet"),
        ("match", ("--realtime", "1"), "--realtime has no effect without --fleet"),
        ("match", ("--band", "1Hz", "10"), "'1Hz' is not a number; give it in rad/s, without the"),
        (
            "rank",
            ("--fleet", "paper_linear", "--plan", "--live"),
            "--live has no effect with --plan",
        ),
        ("train", ("--plan", "--yes"), "--yes has no effect with --plan"),
        ("resume", ("--plan", "--no-rehearsal"), "--no-rehearsal has no effect with --plan"),
        ("match", ("--picture", "plan.png"), "--picture has no effect without --plan"),
        ("match", ("--plan", "--picture", "plan.jpg"), "plan.jpg must end in .png, .svg, .pdf"),
        ("track", (*FLIGHT, "--horizon", "1"), "--horizon has no effect without --inverse zero"),
        ("track", (*FLIGHT, "--inverse", "own", "--no-learning"), "no effect with --inverse own"),
        ("track", (*FLIGHT, "--inverse", "baseline", "--no-guard"), "--no-guard has no effect"),
        ("rank", ("--sources", "a,,b"), "'a,,b' has an empty name: put one comma between two"),
        ("rank", ("--sources", "a,b, a"), "'a,b, a' names a twice: name each once"),
        ("evaluate", ("--drawings", "clover,"), "'clover,' has an empty name"),
        ("rank", ("--band", "1Hz", "10"), "'1Hz' is not a number; give it in rad/s, without the"),
        ("rank", ("--wait", "-1"), "-1 must be a finite number of at least 0"),
        ("rank", ("--wait", "nan"), "nan must be a finite number of at least 0"),
    ],
)
def test_what_would_be_swallowed_or_guessed_at_is_refused(
    name: str, arguments: tuple[str, ...], words: str, asked: list[Any]
) -> None:
    refused = typed(name, *arguments)
    assert (refused.exit_code, asked) == (2, [])
    assert words in refused.output


def test_names_may_have_spaces_around_them(asked: list[Any]) -> None:
    assert typed("rank", "--sources", " a, b").exit_code == 0
    assert asked[0].sources == ("a", "b")


def test_a_speed_that_is_none_is_refused_by_its_option(asked: list[Any]) -> None:
    refused = typed("evaluate", "--speeds", "0.3,fast")
    assert (refused.exit_code, asked) == (2, [])
    assert "'--speeds': 'fast' is not a number" in refused.output


def test_a_fleet_file_that_is_missing_is_refused(asked: list[Any]) -> None:
    assert isinstance(typed("rank", "--fleet", "no_such_fleet").exception, FleetFileError)
    assert asked == []


def test_rank_can_resume_as_runs_resume_does(asked: list[Any]) -> None:
    assert typed("rank", "--resume", "latest", "--wait", "5", "--runs", "here").exit_code == 0
    assert typed("resume", "latest", "--wait", "5", "--runs", "here").exit_code == 0
    from_rank, from_runs = asked
    assert asdict(from_rank) == asdict(from_runs)


def test_a_resumed_run_is_looked_for_where_it_was_unless_a_router_is_typed(
    asked: list[Any],
) -> None:
    router = "tcp/127.0.0.1:7448"
    assert typed("rank", "--resume", "latest", NUFLEET_ROUTER=router).exit_code == 0
    assert typed("rank", "--resume", "latest", "--connect", router).exit_code == 0
    assert [command.connect for command in asked] == [None, router]


def test_what_the_run_has_set_cannot_be_changed_when_it_is_resumed(asked: list[Any]) -> None:
    refused = typed("rank", "--resume", "latest", "--band", "1", "2")
    assert (refused.exit_code, asked) == (2, [])
    assert "--band is already set by the run; omit it with --resume" in refused.output


def test_a_plan_is_the_command_that_it_is_of_and_moves_nothing(
    asked: list[Any], tmp_path: Path
) -> None:
    picture = str(tmp_path / "plan.png")
    words = ("--picture", picture, "track", *FLIGHT, "--speed", "0.3")
    planned = CliRunner().invoke(command_line(), ["plan", *words])
    assert planned.exit_code == 0, planned.output
    (command,) = asked
    assert (command.target, command.speed) == ("a", 0.3)
    assert (command.plans, command.picture) == (True, Path(picture))
    assert CliRunner().invoke(command_line(), ["plan", "runs", "resume", "x"]).exit_code == 0
    assert (asked[-1].run, asked[-1].plans) == ("x", True)


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("doctor",), "`nufleet doctor` moves no robot: there is nothing to plan"),
        (("runs",), "name one of the commands of `nufleet runs`"),
        (("rnak",), "did you mean `nufleet rank`"),
        (("rank", "--live"), "--live has no effect with --plan"),
        (("rank", "--plan", "--betta"), "No such option"),
        ((), "Missing argument"),
    ],
)
def test_what_cannot_be_planned_is_refused(
    words: tuple[str, ...], said: str, asked: list[Any]
) -> None:
    refused = CliRunner().invoke(command_line(), ["plan", *words], prog_name="nufleet")
    assert (refused.exit_code, asked) == (2, [])
    assert said in refused.output
