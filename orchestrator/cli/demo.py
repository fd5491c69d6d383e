"""`nufleet demo`: the paper's Section V, end to end, on this machine."""

from __future__ import annotations

from pathlib import Path

import click

from orchestrator.cli.options import json_option, runs_option


@click.command()
@click.option("--seed", type=click.IntRange(min=0), default=0, show_default=True)
@click.option(
    "--live",
    is_flag=True,
    help="Serve the recording while it runs: open it with `nufleet view --live`.",
)
@runs_option
@json_option
def demo(seed: int, live: bool, runs_root: Path, as_json: bool) -> None:
    """Rank the paper's linear fleet: a router and four robots, each a process of its own.

    A target (α, β) = (0.85, 0.003) and three sources are tested at seven frequencies; the source
    with the smallest worst-case chordal distance is selected, and every estimate is shown beside
    its closed form.
    """
    from orchestrator.cli.rank_session import RankCommand, rank_and_print
    from shared.fleet_file import find_fleet_file

    rank_and_print(
        RankCommand(
            fleet_file=find_fleet_file("paper_linear"),
            runs_root=runs_root,
            seed=seed,
            live=live,
            as_json=as_json,
            processes=None,
        )
    )
