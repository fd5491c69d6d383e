"""`nufleet completion`: let the shell complete commands, options and names."""

from __future__ import annotations

import click
from click.shell_completion import get_completion_class

_SHELLS = {
    "bash": 'eval "$(nufleet completion bash)"  in ~/.bashrc',
    "zsh": 'eval "$(nufleet completion zsh)"  in ~/.zshrc',
    "fish": "nufleet completion fish | source  in ~/.config/fish/config.fish",
}


@click.command(epilog="\b\n" + "\n".join(_SHELLS.values()))
@click.argument("shell", type=click.Choice(tuple(_SHELLS)))
def completion(shell: str) -> None:
    """Print the script with which SHELL completes what you type after `nufleet`.

    Commands, options, installed fleets and drawings, runs, and with --fleet the robots of that
    file. Put this line into the file that your shell reads when it starts:
    """
    script = get_completion_class(shell)
    root = click.get_current_context().find_root().command
    if script is None:
        raise click.UsageError(f"{shell} has no completion")
    click.echo(script(root, {}, "nufleet", "_NUFLEET_COMPLETE").source())
