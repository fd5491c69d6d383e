"""The figure that shows whether experience of more similar robots helped more."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nufleet.orchestrator.evaluation.summaries import mean_kendall_tau, pooled_kendall_tau
from nufleet.orchestrator.evaluation.values import TransferPair
from nufleet.orchestrator.runs.figures import label_places, new_figure, plain, prior_colours, save
from nufleet.shared.errors import InvalidInputError

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


def scatter(png: Path, pairs: Sequence[TransferPair]) -> None:
    """Draw ψ̂* against the ratio of the error to the baseline's for ordered pairs of robots.

    The title gives Kendall's τ over all pairs and, with several targets, its mean over the targets.
    Pairs with a flight that was not finished are drawn as triangles at the upper edge.

    Args:
        png: File to write.
        pairs: Pairs to draw; each target gets a colour.

    Raises:
        InvalidInputError: There are fewer than two pairs.
    """
    if len(pairs) < 2:
        raise InvalidInputError(f"a rank correlation needs at least two pairs, got {len(pairs)}")
    targets = sorted({pair.target for pair in pairs})
    figure = new_figure(8.0, 5.5)
    axes = figure.add_subplot()
    finite = [p.ratio for p in pairs if math.isfinite(p.ratio)]
    top = max(1.1, 1.06 * max(finite, default=1.0))
    colours = prior_colours(targets)
    for target in targets:
        some = [p for p in pairs if p.target == target]
        for mark, unfinished in (("o", False), ("^", True)):
            kept = [p for p in some if math.isinf(p.ratio) == unfinished]
            axes.plot(
                [p.psi for p in kept],
                [min(p.ratio, top) for p in kept],
                mark,
                color=colours[target],
                ms=5,
            )
    plain(axes)
    axes.set_xlim(0.0, 1.1 * max(p.psi for p in pairs))
    axes.set_ylim(0.0, 1.04 * top)
    axes.set_xlabel(r"estimate $\hat{\psi}^*$ of the worst-case chordal distance")
    axes.axhline(1.0, color="0.5", lw=0.8, ls="--")
    axes.set_ylabel("RMS tracking error relative to the baseline")
    title = (
        f"target→source, {len(pairs)} pairs: Kendall's τ = {_rounded(pooled_kendall_tau(pairs))}"
    )
    if len(targets) > 1:
        title += f"; mean over targets {_rounded(mean_kendall_tau(pairs))}"
    axes.set_title(title, loc="left", fontsize=10)
    _label(figure, axes, pairs, [colours[pair.target] for pair in pairs], top)
    save(figure, png)


def _rounded(tau: float | None) -> str:
    return "undefined" if tau is None else f"{tau:.2f}".replace("-", "−")


def _label(
    figure: Figure, axes: Axes, pairs: Sequence[TransferPair], colours: list[str], top: float
) -> None:
    """Write the names of the pairs next to their points, without overlap."""
    # The position of the axes is only known after the figure has been drawn once.
    figure.canvas.draw()
    origin, corner = axes.transAxes.transform([(0.0, 0.0), (1.0, 1.0)])
    points = [(p.psi, min(p.ratio, top)) for p in pairs]
    places = axes.transData.transform(points) - origin
    texts = [f"{p.target}→{p.source}" for p in pairs]
    labels = [axes.text(0, 0, text, fontsize=6.5) for text in texts]
    boxes = [label.get_window_extent() for label in labels]
    sizes = np.array([(box.width, box.height) for box in boxes])
    corners = label_places(places, sizes, tuple(corner - origin)) + origin
    inverse = axes.transData.inverted()
    for label, box, place, colour in zip(
        labels, np.column_stack([corners, corners + sizes]), points, colours, strict=True
    ):
        label.set_position(tuple(inverse.transform(box[:2])))
        label.set_verticalalignment("bottom")
        label.set_color(colour)
        # Connect the point with the nearest point of its label, which may be some way off.
        end = np.clip(axes.transData.transform(place), box[:2], box[2:])
        x, y = zip(place, inverse.transform(end), strict=True)
        axes.plot(x, y, color=colour, lw=0.5, alpha=0.6, zorder=1)
