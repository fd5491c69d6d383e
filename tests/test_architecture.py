"""The import directions that keep the parts apart, as docs/architecture.md lists them."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs" / "architecture.md"
FOLDERS = ("orchestrator", "robot_agent", "shared", "sims")
BETWEEN_FOLDERS = {
    "shared": set[str](),
    "robot_agent": {"shared"},
    "orchestrator": {"shared"},
    "sims": {"shared", "robot_agent.robot"},
}
ROOMS_MAX, FLOORS_MAX = 18, 10
"""Limits of each folder: the sub-packages and modules directly in it, and the longest chain of
imports among them."""

HOW_TO_DECIDE = """\
An arrow is welcome when the importing part may not be understood without the imported one, and
nothing below it needs the importing part. Otherwise move the code to the part whose subject it
is, or hand over a plain value or a callable. If it is welcome, add it to the table "What may
import what" in docs/architecture.md, in the same commit."""


def name_of(path: Path) -> str:
    """Return a module's name without the leading `nufleet.`, such as `shared.wire.codec`."""
    return ".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")


MODULES = {
    name_of(path): path
    for folder in FOLDERS
    for path in sorted((ROOT / folder).rglob("*.py"))
    if "migrations" not in path.parts
}
PACKAGES = {name for name, path in MODULES.items() if path.name == "__init__.py"}


def part_of(module: str) -> str:
    """Return the part that a module belongs to: its package, if that holds no other package.

    Modules beside packages count singly: `orchestrator.viewer.events` lies below
    `orchestrator.viewer.draw`, and `orchestrator.viewer.writer` above it.
    """
    package = module if module in PACKAGES else module.rpartition(".")[0]
    beside = any(other.startswith(f"{package}.") for other in PACKAGES)
    return module if beside or "." not in package else package


PARTS = sorted(
    part
    for part in {part_of(module) for module in MODULES}
    if part not in PACKAGES or not any(other.startswith(f"{part}.") for other in PACKAGES)
)


@cache
def imports(module: str, *, at_once: bool = False) -> frozenset[str]:
    """Return what of ours a module imports; `at_once` leaves out what waits until it is used."""
    tree = ast.parse(MODULES[module].read_text(encoding="utf-8"))
    found: set[str] = set()
    for node in statements(tree, at_once=at_once):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module is not None:
            names = {f"{node.module}.{alias.name}" for alias in node.names}
            modules = {name for name in names if name.removeprefix("nufleet.") in MODULES}
            found |= modules or {node.module}
    return frozenset(found)


def statements(node: ast.AST, *, at_once: bool) -> Iterator[ast.AST]:
    for child in ast.iter_child_nodes(node):
        deferred = isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef | ast.Lambda) or (
            isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test)
        )
        if not (at_once and deferred):
            yield child
            yield from statements(child, at_once=at_once)


def ours(module: str, *, at_once: bool = False) -> set[str]:
    found = {name.removeprefix("nufleet.") for name in imports(module, at_once=at_once)}
    return {name for name in found if name in MODULES}


def arrows() -> dict[str, set[str]]:
    """Return, for each part, the parts that it imports."""
    found: dict[str, set[str]] = {part: set() for part in PARTS}
    for module in MODULES:
        part = part_of(module)
        if part in found:
            found[part] |= ({part_of(other) for other in ours(module)} & set(PARTS)) - {part}
    return found


def rooms(folder: str) -> dict[str, set[str]]:
    """Return, for each sub-package and module directly in a folder, those that it imports."""

    def room_of(module: str) -> str:
        return ".".join(module.split(".")[:2])

    found: dict[str, set[str]] = {}
    for module in MODULES:
        if module.startswith(f"{folder}."):
            imported = {room_of(name) for name in ours(module) if name.startswith(f"{folder}.")}
            found.setdefault(room_of(module), set()).update(imported - {room_of(module)})
    return found


NETWORK = {"shared.wire.requests", "shared.wire.session", "shared.wire.transport"}


def tables() -> dict[str, str]:
    """Return the tables of docs/architecture.md as the source tree says them."""
    described = "".join(
        f"| `{name}` | {ast.get_docstring(ast.parse(MODULES[name].read_text()))} |\n"
        for name in sorted(PACKAGES)
    )
    listed = "".join(
        f"| `{part}` | {', '.join(f'`{other}`' for other in sorted(found)) or '–'} |\n"
        for part, found in sorted(arrows().items())
    )
    return {
        "packages": f"| package | what it is |\n|---|---|\n{described}",
        "arrows": f"| part | may import |\n|---|---|\n{listed}",
    }


def table_in_page(mark: str) -> dict[str, str]:
    text = PAGE.read_text(encoding="utf-8")
    between = text.partition(f"<!-- {mark} -->")[2].partition(f"<!-- end of {mark} -->")[0]
    rows = re.findall(r"^\| `([^`]+)` \| (.*) \|$", between, flags=re.MULTILINE)
    return dict(rows)


def allowed_arrows() -> dict[str, set[str]]:
    return {
        part: set(re.findall(r"`([^`]+)`", row)) for part, row in table_in_page("arrows").items()
    }


def loaded_with(module: str) -> set[str]:
    """Return every module that importing one loads, without what waits until it is used."""
    loaded: set[str] = set()
    open_modules = [module]
    while open_modules:
        name = open_modules.pop()
        if name not in loaded:
            loaded.add(name)
            open_modules += ours(name, at_once=True)
    return loaded


def importers(*libraries: str) -> set[str]:
    return {
        module
        for module in MODULES
        if any(name.partition(".")[0] in libraries for name in imports(module))
    }


@pytest.mark.parametrize("module", MODULES)
def test_a_module_imports_only_what_its_folder_may(module: str) -> None:
    folder = module.partition(".")[0]
    wrong = {
        name
        for name in ours(module)
        if name.partition(".")[0] != folder
        and not any(f"{name}.".startswith(f"{allowed}.") for allowed in BETWEEN_FOLDERS[folder])
    }
    assert not wrong


@pytest.mark.parametrize("part", PARTS)
def test_a_part_imports_only_what_the_page_of_the_architecture_allows(part: str) -> None:
    allowed, found = allowed_arrows(), arrows()[part]
    assert part in allowed, f"docs/architecture.md does not list {part}"
    new = {
        f"{part} -> {other} (imported by {', '.join(witnesses(part, other))})"
        for other in found - allowed[part]
    }
    assert not new, f"new arrows: {'; '.join(sorted(new))}\n{HOW_TO_DECIDE}"
    gone = allowed[part] - found
    assert not gone, f"{part} imports {sorted(gone)} no more: take them from docs/architecture.md"


def witnesses(part: str, other: str) -> list[str]:
    return [
        module
        for module in MODULES
        if part_of(module) == part and other in {part_of(name) for name in ours(module)}
    ]


def test_the_page_of_the_architecture_lists_no_part_that_is_gone() -> None:
    assert allowed_arrows().keys() <= set(PARTS)


def test_the_page_of_the_architecture_describes_packages_as_they_describe_themselves() -> None:
    described: Mapping[str, str] = table_in_page("packages")
    assert described == {
        name: ast.get_docstring(ast.parse(MODULES[name].read_text())) for name in PACKAGES
    }


def test_no_arrows_lead_back_to_where_they_came_from() -> None:
    try:
        TopologicalSorter(arrows()).prepare()
    except CycleError as error:
        pytest.fail(f"parts import one another in a circle: {' <- '.join(error.args[1])}")


@pytest.mark.parametrize("folder", FOLDERS)
def test_a_folder_has_few_rooms_on_few_floors_and_no_circle(folder: str) -> None:
    graph = rooms(folder)
    assert len(graph) <= ROOMS_MAX, f"{folder}: {len(graph)} rooms: {', '.join(sorted(graph))}"
    floors: dict[str, int] = {}
    for room in TopologicalSorter(graph).static_order():  # raises CycleError for a circle
        floors[room] = 1 + max((floors[below] for below in graph[room]), default=0)
    assert max(floors.values()) <= FLOORS_MAX, floors


def test_zenoh_is_imported_by_the_transport_alone() -> None:
    assert importers("zenoh") == NETWORK


def test_nothing_unpickles() -> None:
    assert not importers("pickle", "marshal", "shelve", "dill", "cloudpickle", "joblib")


@pytest.mark.parametrize("part", ["orchestrator.runs", "orchestrator.gap", "orchestrator.drawings"])
def test_what_only_reads_and_calculates_loads_no_network(part: str) -> None:
    for module in MODULES:
        if part_of(module) == part:
            assert not NETWORK & loaded_with(module), module
