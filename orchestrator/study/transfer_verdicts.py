"""Judges from all tests, of either algorithm, whether each source's experience helps the target."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.belief.resting_gain import draw_resting
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.belief.shared_doubt import share_doubt
from nufleet.orchestrator.study.errors_across import ErrorsAcross
from nufleet.orchestrator.study.interface import SourceEstimate, StudyPlan
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum, joined, spectra_of
from nufleet.orchestrator.study.verdict import TransferPrediction, predict_transfer
from nufleet.orchestrator.study.verdict_document import TransferVerdict, verdict_document
from nufleet.shared.arrays import ComplexArray
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.robots.spec import RobotSpec

SAMPLES = 600
CURVE_POINTS = 33

JUDGED_MAX = 64
"""Number of sources that are judged without a motion.

Judging takes up to a third of a second per robot, and low-ranked sources are not transferred from.
"""


@dataclass(frozen=True)
class Judgement:
    """The verdicts on all transfers to one target."""

    verdicts: Mapping[str, TransferVerdict]
    """Verdict on each source, by source, in the order of the ranking."""
    findings: tuple[str, ...]
    """Observations about the robots that weaken the verdicts."""


def judge_transfers(
    plan: StudyPlan,
    ranking: Sequence[SourceEstimate],
    specs: Mapping[str, RobotSpec],
    responses: Mapping[str, Sequence[FrequencyResponse]],
    rng: np.random.Generator,
    *,
    delta: float = 0.05,
) -> Judgement:
    """Judge the transfer from the sources that were tested to the target.

    Errors add up over the axes, each with its share of the motion, and with what one axis does to
    another; see `nufleet.orchestrator.study.errors_across`.

    Args:
        plan: Plan of the study; the verdicts are for its `motion` or, where it has none, for a
            motion with equal power throughout the band, on every axis.
        ranking: Final ranking of the study; without a `motion`, only its first `JUDGED_MAX` sources
            are judged.
        specs: Spec of each robot, by name.
        responses: All usable tests of each robot, in the order of the tests, by robot.
        rng: Generator that draws the samples of each response.
        delta: Accepted probability of a wrong verdict.

    Returns:
        The verdicts on the sources that were tested on all axes; none where the target was not.
    """
    flat = Spectrum.flat(plan.band_rad_s, CURVE_POINTS)
    spectra = spectra_of(plan) or dict.fromkeys(plan.axes, flat)
    together = joined(spectra)
    sources = [estimate.robot for estimate in ranking]
    if plan.motion is None:
        sources = sources[:JUDGED_MAX]
    known = _learned(plan, sources, specs, responses, rng)
    if plan.target not in known:
        return Judgement({}, ())
    drawn = {robot: _drawn(it, flat, spectra, rng) for robot, it in known.items()}
    crossed = ErrorsAcross.of(known[plan.target], spectra, SAMPLES, rng)

    def predict(source: str, axes: Sequence[str], motion: Spectrum | None) -> TransferPrediction:
        """Predict over the band of one axis, where there is no motion, or on the motion."""
        part = slice(0, CURVE_POINTS) if motion is None else slice(CURVE_POINTS, None)
        at_source, at_target = (
            np.concatenate([drawn[robot][axis][:, part] for axis in axes], axis=1)
            for robot in (source, plan.target)
        )
        across = None
        if motion is not None and motion.power.any() and crossed.z:
            own = {axis: z[:, CURVE_POINTS:] for axis, z in drawn[source].items()}
            across = crossed.on(axes, motion, own), crossed.on(axes, motion)
        return predict_transfer(
            *((source, at_source), (plan.target, at_target), motion or flat, plan.band_rad_s),
            across=across,
            delta=delta,
        )

    verdicts = {}
    for source in (name for name in sources if name in known):
        verdicts[source] = verdict_document(
            predict(source, plan.axes, together),
            {axis: predict(source, [axis], None) for axis in plan.axes},
            {axis: predict(source, [axis], spectra[axis]) for axis in plan.axes if plan.also},
        )
    findings = [f for it in known.values() for f in it.findings]
    if crossed.z:
        findings.append(crossed.finding)
    findings += [
        finding
        for source in sources
        if source in known
        for axis, at_source in known[source].axes.items()
        for finding in _gaps(at_source, known[plan.target].axes[axis])
    ]
    return Judgement(verdicts, tuple(dict.fromkeys(findings)))


def _learned(
    plan: StudyPlan,
    sources: Sequence[str],
    specs: Mapping[str, RobotSpec],
    responses: Mapping[str, Sequence[FrequencyResponse]],
    rng: np.random.Generator,
) -> dict[str, AxesKnowledge]:
    """Return what is known of the target and the sources that were tested on all axes."""
    known = {}
    for robot in (plan.target, *sources):
        one = AxesKnowledge(robot, specs[robot], plan.band_rad_s[1], plan.axes)
        for response in responses.get(robot, ()):
            one.learn(response, rng)
        if not one.unseen:
            known[robot] = one
    for axis in plan.axes:
        if known:
            share_doubt([robot.axes[axis] for robot in known.values()])
    return known


def _drawn(
    known: AxesKnowledge,
    flat: Spectrum,
    spectra: Mapping[str, Spectrum],
    rng: np.random.Generator,
) -> dict[str, ComplexArray]:
    """Return samples on every axis, over the band and then at the frequencies of the motion."""
    return {
        axis: draw_resting(
            one.model,
            np.concatenate([flat.omega_rad_s, spectra[axis].omega_rad_s]),
            SAMPLES,
            rng,
        )
        for axis, one in known.axes.items()
    }


def _gaps(source: RobotKnowledge, target: RobotKnowledge) -> Iterator[str]:
    """Yield the comparisons that rest on the robots' models alone, since no test covers them."""
    bands = []
    for known in (source, target):
        omega = known.omega_rad_s
        bands.append((float(omega.min()), float(omega.max())))
        if bands[-1][0] == bands[-1][1]:
            yield (
                f"{known.robot} was tested at {bands[-1][0]:.4g} rad/s only: at other frequencies "
                "its response is guessed from typical robots; test it at more frequencies"
            )
    low, high = max(low for low, _ in bands), min(high for _, high in bands)
    if low > high:
        (low_s, high_s), (low_t, high_t) = bands
        yield (
            f"{source.robot} was tested from {low_s:.4g} to {high_s:.4g} rad/s and "
            f"{target.robot} from {low_t:.4g} to {high_t:.4g} rad/s: their distance is not "
            "measured at any frequency; test both over the same band"
        )


def by_predicted_error(
    ranking: tuple[SourceEstimate, ...],
    verdicts: Mapping[str, TransferVerdict],
    *,
    first: str | None = None,
) -> tuple[SourceEstimate, ...]:
    """Return a ranking sorted by predicted error, smallest first.

    Args:
        ranking: Estimates to sort.
        verdicts: Verdict on each source, by source.
        first: Name of the source to put first in any case; the source that is most certainly good
            need not have the smallest median error.
    """

    def place(estimate: SourceEstimate) -> tuple[bool, float]:
        return estimate.robot != first, verdicts[estimate.robot].error_with.median

    return tuple(sorted(ranking, key=place))
