"""The `nufleet` command: gathers the commands that each package contributes.

Commands are entry points of the group `nufleet.commands`; a dot in a name makes a sub-command
(`fleet.up`). Errors become one line and an exit code: 0 done, 1 the answer is no or it failed,
2 wrong usage, 130 interrupted.
"""

from __future__ import annotations

import atexit
import errno
import gc
import logging
import os
import resource
import shutil
import signal
import sys
from collections.abc import Callable, Mapping
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points, version
from pathlib import Path
from types import FrameType
from typing import Any, NoReturn, TypeVar

import click

from nufleet.shared.errors import InvalidInputError, NufleetError
from nufleet.shared.text import printable

F = TypeVar("F", bound=Callable[..., Any])
ENTRY_POINT_GROUP = "nufleet.commands"
_YOUNG_OBJECTS = 100_000
"""Objects made between two looks for garbage; loading modules makes many, and keeps them."""
_DISK_TROUBLE = (errno.ENOSPC, errno.EDQUOT, errno.EROFS)
_GROUP_HELP = {
    "audit": "Look at the audit log of a robot: who asked it for what.",
    "drawing": "Import, draw and look at the drawings that robots track.",
    "fleet": "Start a simulated fleet, show a running one, or close one with certificates.",
    "robot": "Check the driver of a robot, or begin to write one.",
    "runs": "Look at earlier runs, resume one that was interrupted, or delete old ones.",
}


def folder_option(*names: str, **settings: Any) -> Callable[[F], F]:
    """Return an option of a command that takes a folder, with further settings for click."""
    folder = click.Path(file_okay=False, path_type=Path)
    return click.option(*names, type=folder, metavar="FOLDER", **settings)


class _OneLine(logging.Formatter):
    """Prints text from the network or a driver without letting it control the terminal.

    What another library says is preceded by its name.
    """

    def formatMessage(self, record: logging.LogRecord) -> str:  # noqa: N802 - its name there
        library = record.name.partition(".")[0]
        source = "" if library == "nufleet" else f"{library}: "
        return printable(f"{record.levelname.lower()}: {source}{record.getMessage()}")


class EntryPointGroup(click.Group):
    """A group whose commands are loaded from their packages only when they are needed."""

    def __init__(self, entries: Mapping[str, EntryPoint], **settings: object) -> None:
        super().__init__(**settings)  # type: ignore[arg-type]
        self._entries = entries

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of the commands and groups below this one."""
        return sorted({name.partition(".")[0] for name in self._entries})

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Load a command, or make the group of its sub-commands."""
        if cmd_name in self._entries:
            command: click.Command = self._entries[cmd_name].load()
            return command
        below = {
            name.removeprefix(f"{cmd_name}."): entry
            for name, entry in self._entries.items()
            if name.startswith(f"{cmd_name}.")
        }
        if not below:
            return None
        return EntryPointGroup(below, name=cmd_name, help=_GROUP_HELP.get(cmd_name))

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """Find the command that was typed; suggest others if there is none of that name."""
        if not ctx.resilient_parsing:  # which completes an unfinished line
            command = self.get_command(ctx, args[0])
            if command is None:
                ctx.fail(f"no such command {args[0]!r}; {self._suggestion(args[0], ctx)}")
            _refuse_misread_words(command, args[1:], ctx)
        return super().resolve_command(ctx, args)

    def _suggestion(self, typed: str, ctx: click.Context) -> str:
        known = [name.replace(".", " ") for name in sorted(self._entries)]
        groups = self.list_commands(ctx)
        same = [name for name in known if name.endswith(f" {typed}")]
        close = same or get_close_matches(typed, sorted({*groups, *known}), n=3)
        if close:
            return f"did you mean {' or '.join(f'`{ctx.command_path} {name}`' for name in close)}?"
        return f"`{ctx.command_path}` has {', '.join(groups)}"


def command_line() -> click.Group:
    """Return the root command."""
    entries = {entry.name: entry for entry in entry_points(group=ENTRY_POINT_GROUP)}

    def begin(verbose: bool) -> None:
        handler = logging.StreamHandler(sys.stderr)
        handler.setFormatter(_OneLine())
        logging.basicConfig(level=logging.WARNING, handlers=[handler])
        if verbose:
            logging.getLogger("nufleet").setLevel(logging.INFO)

    return EntryPointGroup(
        entries,
        name="nufleet",
        callback=begin,
        help=_HELP,
        context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
        params=[
            click.Option(["-v", "--verbose"], is_flag=True, help="Print more messages on stderr."),
            click.Option(
                ["--version"],
                is_flag=True,
                is_eager=True,
                expose_value=False,
                callback=_print_version,
                help="Print the version and exit.",
            ),
        ],
    )


def spare_processor_time() -> None:
    """Set what saves processor time in any program of ours, before it imports NumPy."""
    # The matrices are many and small; with threads, BLAS takes ten times as long on a busy machine.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    # pydantic reads the description of every installed package in search of plugins for itself.
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
    # A fifth of the time of a short command went into looks for garbage while modules are loaded,
    # where there is none, and at the end, where the system takes everything back.
    gc.set_threshold(_YOUNG_OBJECTS)
    atexit.register(gc.freeze)


def open_all_files_allowed() -> None:
    """Raise the number of files that this process may open to the largest that it is allowed.

    Many systems allow 1024 unless a program asks for more, as some can handle no larger numbers; an
    agent of 300 robots opens more.
    """
    _, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))


def main() -> NoReturn:
    """Run the command line and exit with its code."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, _interrupt)
    try:
        spare_processor_time()
        open_all_files_allowed()
        code = command_line().main(prog_name="nufleet", standalone_mode=False)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(130)
    except NufleetError as error:
        _print_error(str(error))
        sys.exit(error.exit_code)
    except OSError as error:
        if error.errno not in _DISK_TROUBLE:
            raise
        # A disk can be full at any write, and none of those places has a better remedy.
        place = f" ({error.filename})" if error.filename else ""
        remedy = "free some space and retry"
        if error.errno == errno.EROFS:
            remedy = "choose writable folders with NUFLEET_STATE and NUFLEET_RUNS"
        _print_error(f"cannot write: {os.strerror(error.errno)}{place}; {remedy}")
        sys.exit(NufleetError.exit_code)
    # Without its standalone mode click returns the code of `--help`, `--version` and `Exit`.
    sys.exit(code if isinstance(code, int) else 0)


def ask_before(moving: str, *, instead: str) -> None:
    """Ask the person at the terminal whether robots may move.

    Args:
        moving: Which robots will do what, in words.
        instead: Option that moves nothing, and what it is for.

    Raises:
        InvalidInputError: No person is at the terminal to be asked.
        click.Abort: The person declined.
    """
    if not sys.stdin.isatty():
        raise InvalidInputError(
            f"{moving}, and no person is at the terminal to be asked: give --yes to allow it, or "
            f"{instead}"
        )
    click.confirm(f"{moving}. Continue?", abort=True, err=True)


def restart_within(environment: Mapping[str, str]) -> None:
    """Run this program again from its beginning, unless it has these environment variables.

    Some simulators read them while they are imported.
    """
    missing = {key: value for key, value in environment.items() if os.environ.get(key) != value}
    if missing:
        os.execve(sys.executable, sys.orig_argv, {**os.environ, **missing})


def invocation() -> str:
    """Return how to start nufleet as this program did, for hints on the command to type next."""
    called = Path(sys.argv[0])
    if called.name != "nufleet":  # `python -m nufleet`, or a script or notebook that uses it
        return f"{sys.executable} -m nufleet"
    found = shutil.which("nufleet")
    # A relative name leads nowhere once the program has changed its folder.
    here = found and called.exists() and Path(found).samefile(called)
    return "nufleet" if here else str(called)


_HELP = """Find out which robot's experience will help a new robot, before you transfer it.

\b
Try it:       nufleet demo
Your robots:  nufleet router             on one machine
              nufleet agent FLEET.toml   beside each robot
              nufleet rank --target ...  on any machine: finds the closest source
Experience:   nufleet train              trains the experiences of robots
              nufleet transfer, track    a robot flies with the experience of another
"""


def _refuse_misread_words(command: click.Command, args: list[str], parent: click.Context) -> None:
    """Refuse an option that is given twice although only its last value would count, and a list
    without commas, of which only the first value would."""
    context = command.context_class(command, info_name=command.name, parent=parent)
    _, left, order = command.make_parser(context).parse_args(args=list(args))
    lists = [one for one in order if isinstance(one, click.Option) and "," in (one.metavar or "")]
    if left and lists:
        name, metavar = lists[-1].opts[0], lists[-1].metavar
        raise click.UsageError(
            f"unexpected: {' '.join(left)}. Write a list with commas and without spaces: "
            f"{name} {metavar}",
            context,
        )
    for option in order:
        single = isinstance(option, click.Option) and not (option.multiple or option.is_flag)
        if single and order.count(option) > 1:
            raise click.UsageError(f"{option.opts[0]} is given more than once", context)


def _print_error(sentence: str) -> None:
    click.secho("error: ", fg="red", bold=True, nl=False, err=True)
    # A message may have several lines, for example one from each of several processes.
    click.echo("\n".join(printable(line) for line in sentence.splitlines()), err=True)


def _print_version(ctx: click.Context, _option: click.Parameter, wanted: bool) -> None:
    if wanted:
        click.echo(f"nufleet {version('nufleet')}")
        ctx.exit()


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    """Make every termination as orderly as Ctrl-C: robots at rest, recordings closed."""
    raise KeyboardInterrupt
