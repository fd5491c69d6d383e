"""Which source to take for each axis, where axes disagree on the best one."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from nufleet.orchestrator.study.interface import AxisEstimate, SourceEstimate
from nufleet.shared.wire.messages import ExperienceOffer, ForeseenWay
from nufleet.shared.wire.motions import AxisPrior


def sources_by_axis(ranking: Sequence[SourceEstimate]) -> dict[str, str]:
    """Return the source to take for each axis; empty where the selected one is as good on all.

    An axis takes another source than the selected one only if that is closer there beyond doubt:
    the intervals of their distances are apart.

    Args:
        ranking: Estimates of a ranking, the selected source first.
    """
    if not ranking or ranking[0].axes is None:
        return {}
    selected, chosen = ranking[0], {}
    for axis, own in ranking[0].axes.items():
        on_axis = {one.robot: one.axes[axis] for one in ranking if one.axes and axis in one.axes}
        best = min(on_axis, key=lambda robot: on_axis[robot].psi)
        chosen[axis] = best if on_axis[best].psi_high < own.psi_low else selected.robot
    return chosen if len(set(chosen.values())) > 1 else {}


def way_by_axis(
    priors: Sequence[ExperienceOffer], ranking: Sequence[SourceEstimate]
) -> ForeseenWay | None:
    """Return the way in which each axis takes its own source's experience.

    Args:
        priors: Priors that the robot holds.
        ranking: Estimates of its latest ranking, the selected source first.

    Returns:
        The way; None where axes agree on the source, and where a source's experience is not held or
        was not learned on its axis.
    """
    held = {prior.manifest.robot: prior for prior in priors}
    chosen = sources_by_axis(ranking)
    if not chosen or any(
        source not in held or axis not in held[source].manifest.axes
        for axis, source in chosen.items()
    ):
        return None
    return way_with(chosen, {source: prior.sha256 for source, prior in held.items()})


def way_with(chosen: Mapping[str, str], held: Mapping[str, str]) -> ForeseenWay:
    """Return the way in which each axis takes the experience of a given source.

    Args:
        chosen: Sources by axis.
        held: SHA-256 of the experience that the robot holds of each source, by source.
    """
    by_axis = tuple(AxisPrior(axis=axis, sha256=held[source]) for axis, source in chosen.items())
    return ForeseenWay(inverse="prior", prior_sha256=by_axis[0].sha256, prior_by_axis=by_axis)


def in_words(chosen: Mapping[str, str], ranking: Sequence[SourceEstimate]) -> str:
    """Return which source is taken for each axis, with its distance and that of the selected one.

    Args:
        chosen: Sources by axis, from `sources_by_axis`.
        ranking: Estimates of the ranking, the selected source first.
    """
    estimates: dict[str, Mapping[str, AxisEstimate]] = {e.robot: e.axes or {} for e in ranking}
    selected = ranking[0].robot
    parts = []
    for axis, source in chosen.items():
        psi = f"ψ* = {estimates[source][axis].psi:.4f}"
        if source != selected:
            psi += f", that of {selected} {estimates[selected][axis].psi:.4f}"
        parts.append(f"{axis} from {source} ({psi})")
    return " and ".join(parts)
