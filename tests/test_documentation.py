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
from page_blocks import PAGES, ROOT, blocks

from nufleet.shared.command_line import command_line
from nufleet.shared.robots.fleet_file import read_fleet_file

NOT_RUN_MAX = 7
"""Largest number of blocks that no test runs; each states its reason in the page's source."""
LOADED = re.compile(r"<(?:script|link|img)[^>]+(?:src|href)=\"?([^\"\s>]+)")
CODE = re.compile(r"`((?:shared|orchestrator|robot_agent|sims)(?:\.\w+)+)`")


def commands(page: Path) -> list[list[str]]:
    """The words of every `nufleet …` line in the blocks of a page, without its comment."""
    typed = [shlex.split(command) for block in blocks(page) for command in block.commands]
    return [words[1:] for words in typed if words[0] == "nufleet"]


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


def test_a_page_that_includes_a_file_shows_it(site: Path) -> None:
    texts = {page.name: page.read_text(encoding="utf-8") for page in site.glob("*.html")}
    assert [name for name, text in texts.items() if re.search(r"--8 ?(<|&lt;)", text)] == []
    assert "DroneSettings" in texts["your-robot.html"]  # a class of the driver of rotorpy


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
    for block in blocks(page):
        if block.language == "toml" and "schema" in tomllib.loads(block.code):
            path = tmp_path / "lab.toml"
            path.write_text(block.code)
            assert read_fleet_file(path).robots


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_a_test_runs_the_blocks_of_a_page_or_the_page_says_why_not(page: Path) -> None:
    typed = [b for b in blocks(page) if b.commands or b.language == "python"]
    for block in typed:
        sources = "".join(test.read_text(encoding="utf-8") for test in block.tests)
        missing = [command for command in block.commands if command not in sources]
        assert not block.tests or not missing, f"{missing} is in none of {block.tests}"
    if any(block.is_run for block in typed):
        followed = f'follow("{page.relative_to(ROOT)}")'
        tests = (ROOT / "tests").rglob("test_*.py")
        assert any(followed in test.read_text(encoding="utf-8") for test in tests), followed


def test_few_blocks_are_not_run_and_each_says_why() -> None:
    reasons = [f"{page.name}: {b.reason}" for page in PAGES for b in blocks(page) if b.reason]
    print(*reasons, sep="\n")  # noqa: T201 - for `pytest -s`
    assert len(reasons) <= NOT_RUN_MAX, reasons


def test_what_the_method_names_is_in_the_code() -> None:
    for name in CODE.findall((ROOT / "docs" / "method.md").read_text(encoding="utf-8")):
        parts, defined = name.split("."), list[str]()
        while not (file := ROOT.joinpath(*parts).with_suffix(".py")).exists():
            defined.append(parts.pop())
            assert parts, f"{name} is no module"
        code = file.read_text(encoding="utf-8")
        assert all(re.search(rf"(def|class) {one}\b", code) for one in defined), name
