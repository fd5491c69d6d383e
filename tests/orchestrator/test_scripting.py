"""What programs outside of this project use."""

from __future__ import annotations

import inspect
import subprocess
import sys
from collections.abc import Callable
from dataclasses import fields
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any

import click
import pytest

import nufleet
from nufleet.orchestrator import scripting
from nufleet.orchestrator.jobs.rank import RankCommand
from nufleet.orchestrator.jobs.track import TrackCommand
from nufleet.orchestrator.jobs.transfer import TransferCommand
from nufleet.shared.errors import InvalidInputError

RENAMED = {"fleet": "fleet_file"}
ONLY_OF_A_COMMAND = {"as_json", "picture", "plans", "processes", "yes"}
"""A function returns what `--json` prints, and asks no one; a fleet's processes are a detail."""


@pytest.mark.parametrize(
    ("function", "command"),
    [
        (scripting.rank, RankCommand),
        (scripting.track, TrackCommand),
        (scripting.transfer, TransferCommand),
    ],
)
def test_a_function_takes_the_options_of_its_command(
    function: Callable[..., Any], command: type[Any]
) -> None:
    parameters = {RENAMED.get(name, name) for name in inspect.signature(function).parameters}
    wanted = {field.name for field in fields(command)} - ONLY_OF_A_COMMAND
    assert parameters - {"console"} == wanted


@pytest.mark.parametrize("name", ["rank", "track", "transfer"])
def test_options_have_the_same_defaults_in_scripts_and_on_the_command_line(name: str) -> None:
    (entry,) = entry_points(group="nufleet.commands", name=name)
    command = entry.load()
    options = {option.name: option for option in command.params if isinstance(option, click.Option)}
    for parameter in inspect.signature(getattr(scripting, name)).parameters.values():
        option = options.get(RENAMED.get(parameter.name, parameter.name))
        if option is None or option.required or parameter.default is inspect.Parameter.empty:
            continue
        context = click.Context(command)
        default = option.get_default(context)
        if isinstance(default, click.core.ParameterSource) or repr(default) == "Sentinel.UNSET":
            default = None
        assert _plain(parameter.default) == _plain(default), parameter.name


def _plain(default: Any) -> Any:
    return str(default) if isinstance(default, Path) else default or None


def test_everything_public_is_described_and_can_be_imported() -> None:
    for name in nufleet.__all__:
        assert inspect.getdoc(getattr(nufleet, name)), name


def test_a_misspelt_name_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="has no attribute 'rnak'"):
        nufleet.rnak  # type: ignore[attr-defined]  # noqa: B018


def test_importing_nufleet_imports_nothing_heavy() -> None:
    asked = "import sys, nufleet; print(sorted({'numpy', 'zenoh', 'pydantic'} & set(sys.modules)))"
    found = subprocess.run([sys.executable, "-c", asked], capture_output=True, text=True)
    assert found.stdout.strip() == "[]", found.stderr


def test_a_run_that_is_not_there_is_an_error_that_names_the_folder(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="no run 'latest'"):
        nufleet.load_run(runs_root=tmp_path)
