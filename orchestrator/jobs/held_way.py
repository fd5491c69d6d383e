"""The way in which a robot flies with the experiences that it holds, where none is asked for."""

from __future__ import annotations

from collections.abc import Sequence

from nufleet.orchestrator.flights.labels import BY_AXIS, MIXTURE
from nufleet.orchestrator.flights.start_weights import mixture_of
from nufleet.orchestrator.history.rankings import Ranking
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.source_by_axis import way_by_axis
from nufleet.shared.wire.messages import ExperienceOffer, ForeseenWay


def held_way(priors: Sequence[ExperienceOffer], ranking: Ranking | None) -> tuple[str, ForeseenWay]:
    """Return the way that suits what a robot holds, and its name.

    The experience of the source that the ranking selected, or whose way it chose, flies alone, as
    the paper's prior does. Several of them fly as a mixture, and so does a single feedback of any
    other source: alone it may leave more error than learning from nothing, and in a mixture it is
    shrunk to what helps. A preview flies alone, since none beside it leaves most of the baseline's
    error.

    Args:
        priors: Priors that the robot holds, at least one.
        ranking: Its latest ranking; None without one.

    Returns:
        The name of the source, `by-axis` or `mixture`, and the way.
    """
    estimates: tuple[SourceEstimate, ...] = ()
    trusted = set[str | None]()
    if ranking is not None:
        estimates = ranking.result.ranking
        trusted = {ranking.result.selected, ranking.result.chosen_way}
    by_axis = way_by_axis(priors, estimates)
    if by_axis is not None and len(by_axis.asked) == len(priors):
        return BY_AXIS, by_axis  # they are what `transfer --source best` has left
    manifest = priors[0].manifest
    preview = manifest.layout.architecture == "preview"
    if len(priors) == 1 and (preview or manifest.robot in trusted):
        way = ForeseenWay(inverse="prior", prior_sha256=priors[0].sha256)
        return manifest.robot, way
    psi = {one.robot: one.psi for one in estimates} or None
    return MIXTURE, ForeseenWay(inverse="mixture", mixture=mixture_of(priors, psi))
