"""How the command line ends when there is no room left."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from click.testing import CliRunner

from nufleet.shared import command_line


@pytest.fixture(autouse=True)
def _signals_as_they_were() -> Iterator[None]:
    before = signal.getsignal(signal.SIGTERM)
    yield
    signal.signal(signal.SIGTERM, before)


def end_of(monkeypatch: pytest.MonkeyPatch, error: OSError) -> int | str | None:
    """Run a command that fails; return with what the process would exit."""

    @click.command()
    def fails() -> None:
        raise error

    monkeypatch.setattr(command_line, "command_line", lambda: fails)
    monkeypatch.setattr("sys.argv", ["nufleet"])
    with pytest.raises(SystemExit) as ended:
        command_line.main()
    return ended.value.code


@pytest.mark.parametrize("called", ["bin/pytest", "study.py", "", "-c"])
def test_a_script_that_changed_its_folder_hints_at_commands_all_the_same(
    called: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    program = tmp_path / "bin" / "pytest"
    program.parent.mkdir()
    program.touch(mode=0o755)
    monkeypatch.setenv("PATH", str(program.parent))
    monkeypatch.chdir(tmp_path / "bin")
    monkeypatch.setattr("sys.argv", [called])
    assert command_line.invocation() == f"{sys.executable} -m nufleet"


def test_a_full_disk_is_one_line_that_names_the_file(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), "runs/results.json.part")
    assert end_of(monkeypatch, full) == 1
    (line,) = capsys.readouterr().err.splitlines()
    assert "No space left on device (runs/results.json.part); free some space" in line


def test_a_disk_that_may_only_be_read_is_answered_by_the_variables_that_name_another(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    end_of(monkeypatch, OSError(errno.EROFS, os.strerror(errno.EROFS), "learned"))
    assert "choose writable folders with NUFLEET_STATE and NUFLEET_RUNS" in capsys.readouterr().err


def test_more_messages_are_those_of_nufleet_alone() -> None:
    script = (
        "import logging, sys; from nufleet.shared import command_line; "
        "from importlib.metadata import EntryPoint; sys.argv = ['nufleet', '-v', 'doctor', '-h']\n"
        "try: command_line.main()\n"
        "except SystemExit: pass\n"
        "logging.getLogger('alembic').info('its plugins')\n"
        "logging.getLogger('nufleet.fleet').info('its own')"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True)
    assert done.stderr == "info: its own\n"


def test_an_error_of_the_system_that_nobody_foresaw_is_not_hidden(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with pytest.raises(BlockingIOError):
        end_of(monkeypatch, OSError(errno.EAGAIN, "try again"))


def test_what_others_said_cannot_command_the_terminal() -> None:
    script = (
        "import logging, click; from nufleet.shared import command_line; "
        "from nufleet.shared.errors import NufleetError; root = command_line.command_line\n"
        "def with_one_more():\n"
        "    group = root()\n"
        "    def fail():\n"
        "        logging.getLogger('net').warning('key %s', '\\x1b]0;owned\\x07')\n"
        "        raise NufleetError('robot a refused: \\x1b[31mno\\nand why')\n"
        "    group.get_command = lambda ctx, name: click.Command('fail', callback=fail)\n"
        "    return group\n"
        "command_line.command_line = with_one_more\n"
        "command_line.main()"
    )
    done = subprocess.run([sys.executable, "-c", script, "fail"], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert done.stderr == "warning: net: key ?]0;owned?\nerror: robot a refused: ?[31mno\nand why\n"


def refusal(*arguments: str) -> str:
    ended = CliRunner().invoke(command_line.command_line(), arguments)
    assert ended.exit_code == 2
    return ended.output


@pytest.mark.parametrize(
    ("typed", "suggested"),
    [
        (("rnak",), "did you mean `nufleet rank` or `nufleet track`?"),
        (("runs", "ls"), "did you mean `nufleet runs list`?"),
        (
            ("show",),
            "did you mean `nufleet audit show` or `nufleet drawing show` or `nufleet runs show`?",
        ),
        (("fleet", "down"), "`nufleet fleet` has enroll, init, renew, request, revoke, status, up"),
        (("help",), "Try 'nufleet --help' for help."),
    ],
)
def test_a_command_that_does_not_exist_is_answered_by_those_that_do(
    typed: tuple[str, ...], suggested: str
) -> None:
    assert suggested in refusal(*typed)


@pytest.mark.parametrize(
    ("typed", "option"),
    [
        (("track", "--target", "a", "--trajectory", "clover", "--target", "b"), "--target"),
        (("rank", "--band", "1", "2", "--band=1", "3"), "--band"),
        (("runs", "show", "--runs", "a", "--runs", "b"), "--runs"),
    ],
)
def test_an_option_of_which_only_the_last_value_would_count_is_refused(
    typed: tuple[str, ...], option: str
) -> None:
    assert f"{option} is given more than once" in refusal(*typed)


def test_a_list_without_commas_is_refused_with_the_way_to_write_it() -> None:
    said = refusal("rank", "--fleet", "paper_linear", "--axes", "x", "y")
    assert "unexpected: y. Write a list with commas and without spaces: --axes NAME,NAME" in said
    assert "unexpected extra argument (y)" in refusal("rank", "--target", "x", "y")


def test_a_command_may_open_all_the_files_that_its_system_allows() -> None:
    before = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (before[0] // 2, before[1]))
    try:
        command_line.open_all_files_allowed()
        assert resource.getrlimit(resource.RLIMIT_NOFILE) == (before[1], before[1])
    finally:
        resource.setrlimit(resource.RLIMIT_NOFILE, before)
