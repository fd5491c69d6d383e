"""`nufleet demo`: the whole workflow, end to end, on this machine."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import (
    json_option,
    live_option,
    repository_option,
    runs_option,
)


@click.command()
@click.option(
    "--quadrotors",
    is_flag=True,
    help="In the air: six simulated quadrotors (needs the extra `quadrotors`).",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@live_option
@runs_option
@repository_option
@json_option
def demo(**options: Any) -> None:
    """Rank the paper's linear fleet, transfer the best experience, and track a drawing with it.

    A router and four robots run as processes of their own. A target (α, β) = (0.85, 0.003) and
    three sources are tested at seven frequencies; the source with the smallest worst-case chordal
    distance is selected, and every estimate is shown beside its closed form. Then the closest and
    the furthest source learn inverse models of themselves, and the target tracks a drawing with
    each as its prior, with none, and with its baseline controller alone.
    """
    from nufleet.orchestrator.jobs.demo import DemoCommand, demo_and_print

    demo_and_print(DemoCommand(**options))
