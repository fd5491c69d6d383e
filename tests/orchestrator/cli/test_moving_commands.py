"""Every command that moves robots says before what it will do, and asks; none is left out."""

from __future__ import annotations

import ast
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path
from typing import TypeGuard

import click
import pytest

ROOT = Path(__file__).parents[3]
JOBS = "nufleet.orchestrator.jobs."
MOVES_AT = {"take": 1, "go_on": 2, "fly": 2, "fly_on": 2}
"""Place of what robots will do among the arguments of each method that takes command of them."""
ENTRIES = [
    entry
    for entry in entry_points(group="nufleet.commands")
    if entry.module.startswith("nufleet.orchestrator.cli.")
]
MOVING = {"evaluate", "match", "rank", "runs.resume", "track", "train"}


@cache
def tree(module: str) -> ast.Module:
    path = ROOT / Path(*module.split(".")[1:]).with_suffix(".py")
    return ast.parse(path.read_text(encoding="utf-8"))


def imported(node: ast.AST) -> dict[str, tuple[str, str]]:
    """The module of jobs and the name there, by the name of what is imported from one."""
    return {
        alias.name: (one.module, alias.name)
        for one in ast.walk(node)
        if isinstance(one, ast.ImportFrom) and one.module and one.module.startswith(JOBS)
        for alias in one.names
    }


@cache
def used_by(module: str, name: str) -> frozenset[tuple[str, str]]:
    """The functions and classes, in this module or in those of jobs, that one of them names."""
    here = {node.name: (module, node.name) for node in tree(module).body if defines(node)}
    known = imported(tree(module)) | here
    names = {node.id for node in ast.walk(defined(module, name)) if isinstance(node, ast.Name)}
    return frozenset(known[used] for used in names & known.keys())


def defines(node: ast.AST) -> TypeGuard[ast.FunctionDef | ast.ClassDef]:
    return isinstance(node, ast.FunctionDef | ast.ClassDef)


def defined(module: str, name: str) -> ast.AST:
    found = [node for node in tree(module).body if defines(node) and node.name == name]
    return found[0] if found else ast.Pass()  # a constant or a type


def what_moves(entry: EntryPoint) -> set[str]:
    """What a command says that robots will do where it takes command of them."""
    reached, left = set[tuple[str, str]](), {(entry.module, entry.attr)}
    while left:
        reached |= left
        left = set().union(*(used_by(*one) for one in left)) - reached
    return {
        ast.unparse(node.args[MOVES_AT[node.func.attr]])
        for one in reached
        for node in ast.walk(defined(*one))
        if isinstance(node, ast.Call)
        and isinstance(node.func, ast.Attribute)
        and node.func.attr in MOVES_AT
        and ast.unparse(node.func.value) != "self"  # one step of an opening by another
    }


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda entry: entry.name)
def test_a_command_that_moves_robots_can_plan_and_asks(entry: EntryPoint) -> None:
    moving = bool(what_moves(entry) - {"None", "only_simulated"})
    assert moving == (entry.name in MOVING)
    command: click.Command = entry.load()
    options = {option for parameter in command.params for option in parameter.opts}
    options |= {option for parameter in command.params for option in parameter.secondary_opts}
    wanted = {"--plan", "--picture", "--yes", "--confirm"}
    assert (wanted & options if entry.name != "plan" else set()) == (wanted if moving else set())


def test_robots_are_commanded_through_an_opening_alone() -> None:
    taking = {
        path.name
        for folder in ("jobs", "cli")
        for path in (ROOT / "orchestrator" / folder).glob("*.py")
        if "lease_robots" in path.read_text(encoding="utf-8")
    }
    assert taking == {"opening.py"}
