"""The documentation is built without a warning, and what it tells people to type is understood."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import click
import pytest

from nufleet.shared.command_line import command_line
from nufleet.shared.robots.fleet_file import read_fleet_file

ROOT = Path(__file__).parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
LOADED = re.compile(r"<(?:script|link|img)[^>]+(?:src|href)=\"?([^\"\s>]+)")
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)


def blocks(page: Path, *languages: str) -> list[str]:
    text = page.read_text(encoding="utf-8")
    return [code for language, code in BLOCK.findall(text) if language in languages]


def commands(page: Path) -> list[list[str]]:
    """The words of every `nufleet …` line in the blocks of a page, without its comment."""
    lines = [line for code in blocks(page, "", "bash", "sh") for line in code.splitlines()]
    typed = [shlex.split(line, comments=True) for line in lines if re.match(r"\s*nufleet ", line)]
    return [words[1:] for words in typed]


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    built = subprocess.run(
        [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(folder)],
        cwd=ROOT,
        env={**os.environ, "NO_MKDOCS_2_WARNING": "1"},
        capture_output=True,
        text=True,
    )
    assert built.returncode == 0, built.stderr
    return folder


def test_the_pages_are_built_without_a_warning_and_loaded_without_a_network(site: Path) -> None:
    for page in site.glob("*.html"):
        loaded = LOADED.findall(page.read_text())
        assert not [source for source in loaded if source.startswith(("http", "//"))], page.name


def test_every_command_is_on_the_page_of_the_commands(site: Path) -> None:
    page = (site / "commands.html").read_text(encoding="utf-8")
    for name in ("rank", "fleet up", "runs resume", "robot check", "stop", "completion"):
        assert f"nufleet {name}" in page


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_on_a_page_have_the_options_and_arguments_that_are_typed(page: Path) -> None:
    for words in commands(page):
        context, left = click.Context(command_line(), info_name="nufleet"), words
        while isinstance(context.command, click.Group):
            name, command, left = context.command.resolve_command(context, left)
            assert command is not None, name
            context = click.Context(command, parent=context, info_name=name)
        typed, left, _ = context.command.make_parser(context).parse_args(left)
        assert not left, f"{context.command_path} takes no {left}"
        missing = [
            parameter.name
            for parameter in context.command.params
            if parameter.required and not typed.get(parameter.name or "")
        ]
        assert not missing, f"{context.command_path} {words} lacks {missing}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_fleet_files_on_a_page_are_accepted(page: Path, tmp_path: Path) -> None:
    for text in blocks(page, "toml"):
        if "schema" in tomllib.loads(text):
            path = tmp_path / "lab.toml"
            path.write_text(text)
            assert read_fleet_file(path).robots


def test_the_program_on_the_page_for_python_is_the_example() -> None:
    program = (ROOT / "examples" / "rank.py").read_text().partition("\n\n")[2]
    assert program in blocks(ROOT / "docs" / "python.md", "python")
