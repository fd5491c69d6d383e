"""The page that a run leaves to be handed on: one file, read without a network, and printable."""

from __future__ import annotations

import base64
import csv
import io
import json
import shlex
from collections.abc import Iterator
from html import escape
from pathlib import Path
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from nufleet.orchestrator.history.catalogue import KINDS, Run, read_run
from nufleet.orchestrator.history.tables import run_tables
from nufleet.orchestrator.runs.folder import read_configuration
from nufleet.orchestrator.runs.headline import Headline, write_headline
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.shared.private_files import write_privately

PAGE = "report.html"
RANKING = "ranking.csv"

_QUESTIONS = {
    "rank": "Which robot's experience will help the target most?",
    "demo": "Does the experience that the tests choose help the target in flight?",
    "evaluate": "With which experience does the target track best, and was that predicted?",
    "pairs": "How well do the tests predict which experience helps, over all pairs of robots?",
    "track": "How closely does the robot follow these paths?",
    "train": "What have these robots learned of themselves?",
}
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 60rem; margin: 2rem auto; padding: 0 1rem;
       color: #1a1a1a; background: #fff }
h1 { font-size: 1.5rem; margin-bottom: 0 } h2 { font-size: 1.15rem; margin-top: 2rem }
.answer { font-size: 1.2rem; border-left: 4px solid #009e73; padding-left: .8rem }
.quiet { color: #666 }
table { border-collapse: collapse; margin: .6rem 0 1rem } caption { text-align: left; color: #444 }
th, td { padding: .25rem .7rem; border-bottom: 1px solid #ddd; text-align: left }
td.right, th.right { text-align: right; font-variant-numeric: tabular-nums }
.whole { white-space: nowrap }
img { max-width: 100%; height: auto } pre { white-space: pre-wrap; overflow-wrap: anywhere }
@media print { body { margin: 0; max-width: none } details { display: none }
               table, img { break-inside: avoid } }
"""


def leave_report(folder: Path) -> Path | None:
    """Write the page of a run, its headline and, of a ranking, a table for spreadsheets.

    Args:
        folder: Folder of the run.

    Returns:
        Path of the page; None if the run has no result.

    Raises:
        InvalidInputError: The files of the run cannot be read.
    """
    run = read_run(folder)
    if run.result is None:
        return None
    write_headline(folder, Headline(run.headline, KINDS[run.kind].document))
    if run.ranking is not None:
        write_privately(folder / RANKING, ranking_csv(run.ranking).encode())
    page = folder / PAGE
    write_privately(page, report_page(run, read_configuration(folder)).encode())
    return page


def report_page(run: Run, configuration: dict[str, Any]) -> str:
    """Return the page of a run that has a result.

    Args:
        run: Run with a result.
        configuration: Configuration of the run, as it lies in its folder.
    """
    began = "" if run.began is None else f", begun {run.began:%Y-%m-%d %H:%M} UTC"
    which = f"{run.folder.name}: {run.kind} of fleet {run.fleet}{began}"
    body = [
        f"<h1>{escape(_QUESTIONS[run.kind])}</h1>",
        f'<p class="quiet">{escape(which)}</p>',
        f'<p class="answer">{escape(run.headline)}</p>',
        "<h2>Results</h2>",
        *map(_element, run_tables(run)),
        *_pictures(run.folder),
        "<h2>How to repeat it</h2>",
        *_how_to_repeat(configuration),
    ]
    return (
        '<!doctype html>\n<html lang="en"><head><meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f"<title>{escape(run.folder.name)}</title>\n<style>{_STYLE}</style></head>\n<body>\n"
        + "\n".join(body)
        + "\n</body></html>\n"
    )


def ranking_csv(result: RankResult) -> str:
    """Return a ranking as a table of comma-separated values, best source first."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["source", "psi", "psi_low", "psi_high", "omega_rad_s", "tests", "verdict"])
    for one in result.ranking:
        found = result.verdicts.get(one.robot)
        verdict = "" if found is None else str(found.verdict)
        writer.writerow(
            [*(one.robot, one.psi, one.psi_low, one.psi_high, one.omega_rad_s, one.tests, verdict)]
        )
    return text.getvalue()


def _element(part: RenderableType) -> str:
    """Return a table or a line of text, made for a terminal, as HTML."""
    if isinstance(part, Table):
        return _table(part)
    return f"<p>{_plain(part)}</p>"


def _table(table: Table) -> str:
    classes = [
        f' class="{"right" if column.justify == "right" else ""}{" whole" * column.no_wrap}"'
        for column in table.columns
    ]
    heads = [
        f"<th{kind}>{_plain(column.header)}</th>"
        for kind, column in zip(classes, table.columns, strict=True)
    ]
    rows = [
        "".join(f"<td{kind}>{_plain(cell)}</td>" for kind, cell in zip(classes, row, strict=True))
        for row in zip(*(tuple(column.cells) for column in table.columns), strict=True)
    ]
    caption = f"<caption>{_plain(table.title)}</caption>" if table.title else ""
    head = f"<thead><tr>{''.join(heads)}</tr></thead>" if table.show_header else ""
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f"<table>{caption}{head}<tbody>{body}</tbody></table>"


def _plain(text: object) -> str:
    """Return a text without the markup of a terminal, escaped for HTML."""
    return escape((text if isinstance(text, Text) else Text.from_markup(str(text))).plain)


def _pictures(folder: Path) -> Iterator[str]:
    """Yield all plots of a run, each with its data in the page itself."""
    for png in sorted(folder.rglob("*.png")):
        data = base64.b64encode(png.read_bytes()).decode()
        name = escape(png.stem.replace("_", " "))
        yield f'<figure><img alt="{name}" src="data:image/png;base64,{data}"></figure>'


def _how_to_repeat(configuration: dict[str, Any]) -> Iterator[str]:
    """Yield the command that began the run, the versions that ran it, and all of its settings."""
    if configuration.get("command"):
        yield f"<pre>nufleet {escape(shlex.join(map(str, configuration['command'])))}</pre>"
    versions = configuration.get("versions", {})
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    yield f"<p>With {escape(listed)}.</p>" if listed else ""
    settings = {k: v for k, v in configuration.items() if k not in ("command", "versions")}
    text = escape(json.dumps(settings, indent=1, ensure_ascii=False))
    yield f"<details><summary>All settings</summary><pre>{text}</pre></details>"
