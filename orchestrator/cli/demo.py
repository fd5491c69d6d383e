"""`nufleet demo`: the whole workflow, end to end, on this machine."""

from __future__ import annotations

from typing import Any

import click

from nufleet.orchestrator.cli.options import live_option, storage_options


@click.command()
@click.option(
    "--quadrotors",
    is_flag=True,
    help="In the air: six simulated quadrotors (needs the extra `quadrotors`).",
)
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@live_option
@storage_options
def demo(**options: Any) -> None:
    """Rank a linear fleet, transfer the best and the worst experience, and fly a drawing with them.

    A router and five robots run as processes of their own. A target (α, β) = (0.85, 0.003), the
    three sources of the paper and one that harms play sinusoids; the source with the smallest
    worst-case chordal distance is selected, and every estimate is shown beside its closed form.
    Then the closest and the furthest source learn inverse models of themselves, and the target
    flies a drawing with each as its prior, with both, with none, with its model of itself, and with
    its baseline controller alone. If the guard takes the furthest source's experience back, a last
    flight without the guard shows what it prevented.
    """
    from nufleet.orchestrator.jobs.demo import DemoCommand, demo_and_print

    demo_and_print(DemoCommand(**options))
