"""The mixture of experiences that a target flies with, and the weights that it starts from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from nufleet.shared.wire.messages import ExperienceOffer
from nufleet.shared.wire.motions import Weighted

_PSI_MIN = 0.02
"""Distances below this count as this: tests do not tell them apart."""


def start_weights(
    sources: Sequence[str], psi: Mapping[str, float] | None = None
) -> dict[str, float]:
    """Return the weight of each source before anything is flown.

    Flying without experience counts as one source more, so that k sources share k / (k + 1). They
    share it equally when nothing is known of them. With a ranking their shares are inversely
    proportional to the square of their distance from the target, as those of measurements are to
    the square of their error.

    Args:
        sources: Names of the sources, at least one.
        psi: Estimated distance ψ̂*_n of sources from the target; None without a ranking. A source
            that is not in it counts as far as the furthest.

    Returns:
        The weights by source, positive, whose sum is below 1.
    """
    known = psi or {}
    furthest = max((known[source] for source in sources if source in known), default=1.0)
    closeness = {source: max(_PSI_MIN, known.get(source, furthest)) ** -2 for source in sources}
    shared = len(sources) / (len(sources) + 1)
    total = sum(closeness.values())
    return {source: shared * close / total for source, close in closeness.items()}


def mixture_of(
    priors: Sequence[ExperienceOffer], psi: Mapping[str, float] | None = None
) -> tuple[Weighted, ...]:
    """Return the mixture of all priors that a robot holds.

    Args:
        priors: Priors that the robot holds, at least one, each of another source.
        psi: Estimated distance of sources from the robot; None without a ranking.
    """
    weights = start_weights([prior.manifest.robot for prior in priors], psi)
    return tuple(
        Weighted(sha256=prior.sha256, weight=weights[prior.manifest.robot]) for prior in priors
    )
