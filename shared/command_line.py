"""The `nufleet` command: gathers the commands that each package contributes.

Commands are entry points of the group `nufleet.commands`; a dot in a name makes a sub-command
(`fleet.up`). Errors become one line and an exit code: 0 done, 1 the answer is no or it failed,
2 wrong usage, 130 interrupted.
"""

from __future__ import annotations

import logging
import signal
import sys
from importlib.metadata import entry_points, version
from types import FrameType
from typing import NoReturn

import click

from shared.errors import NufleetError

_GROUPS = {
    "fleet": "Launch a fleet of simulated robots, or see who is there.",
    "runs": "Look at what earlier runs left behind.",
}


@click.group(context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(version("nufleet"), prog_name="nufleet")
@click.option("-v", "--verbose", is_flag=True, help="Say more on stderr while working.")
def _root(verbose: bool) -> None:
    """Find out which robot's experience will help a new robot, before you transfer it.

    \b
    Try it:       nufleet demo
    Your robots:  nufleet router            (on one machine)
                  nufleet agent ...         (beside each robot)
                  nufleet rank --target ... (from anywhere)
    """
    logging.basicConfig(
        level=logging.INFO if verbose else logging.WARNING,
        format="%(name)s: %(message)s",
        stream=sys.stderr,
    )


def command_line() -> click.Group:
    """Return the root command with every installed command in its place."""
    for entry in sorted(entry_points(group="nufleet.commands"), key=lambda e: e.name):
        group, _, name = entry.name.rpartition(".")
        parent = _root
        if group:
            existing = _root.commands.get(group)
            if isinstance(existing, click.Group):
                parent = existing
            else:
                parent = click.Group(group, help=_GROUPS.get(group))
                _root.add_command(parent)
        parent.add_command(entry.load(), name)
    return _root


def main() -> NoReturn:
    """Run the command line and exit with its code."""
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        command_line().main(standalone_mode=False)
    except click.exceptions.Exit as error:
        sys.exit(error.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except (click.Abort, KeyboardInterrupt):
        click.echo("interrupted", err=True)
        sys.exit(130)
    except NufleetError as error:
        click.secho("error: ", fg="red", bold=True, nl=False, err=True)
        click.echo(str(error), err=True)
        sys.exit(error.exit_code)
    sys.exit(0)


def _interrupt(_signal: int, _frame: FrameType | None) -> None:
    """Make SIGTERM as orderly as Ctrl-C: robots at rest, recordings closed."""
    raise KeyboardInterrupt


if __name__ == "__main__":
    main()
