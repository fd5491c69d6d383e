"""What samples of all responses say of the sources: on each axis, and on all axes together.

A source is as far away as on its worst axis, ψ*_n = max over axes i and frequencies of ψ_n,i(ω);
where axes answer to each other, the matrices of all responses are compared. The mean square error
on a trajectory adds up over the axes, each with its share of the trajectory's motion, and with what
one axis does to another.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge, Coupling
from nufleet.orchestrator.belief.response_belief import ResponseModel
from nufleet.orchestrator.belief.resting_gain import draw_resting
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.coupled_distance import coupled_belief, matrix_draws, matters
from nufleet.orchestrator.study.errors_across import ErrorsAcross
from nufleet.orchestrator.study.interface import SourceEstimate, StudyPlan
from nufleet.orchestrator.study.screening import Screened
from nufleet.orchestrator.study.seen import Seen
from nufleet.orchestrator.study.selection_belief import (
    PredictedErrors,
    SelectionBelief,
    part_of_worst,
)
from nufleet.orchestrator.study.trajectory_spectrum import Spectrum, joined, spectra_of
from nufleet.shared.arrays import ComplexArray, FloatArray

Draws = Mapping[str, ComplexArray]
"""Samples of a robot's responses by axis, each of shape (samples, frequencies)."""


@dataclass(frozen=True)
class Compared:
    """The belief about the sources after a round."""

    belief: SelectionBelief
    """Belief about the distances over all axes, and the error on the trajectory."""
    by_axis: Mapping[str, SelectionBelief]
    """Belief about each axis that was tested on all robots, by axis."""
    draws: Mapping[str, Draws]
    """Samples behind them, by robot."""
    findings: tuple[str, ...]
    """How axes were compared, in words; nothing of a single axis."""
    outrun: Mapping[str, str] = field(default_factory=dict)
    """Reason for each source that was not compared, since its tones show that it cannot win."""
    estimates: tuple[SourceEstimate, ...] = ()
    """What is known of all that were not compared in full, by rising distance."""
    coupled: bool = False
    """Whether distances come from the matrices of all axes, and not from the worst axis alone."""

    def beaten(
        self, leader: str, epsilon: float, seen: Mapping[str, Mapping[str, Seen]]
    ) -> tuple[float, dict[str, float]]:
        """Return how sure the leader is if the others may do anything where they were not seen.

        Args:
            leader: Name of the source that is selected now.
            epsilon: Difference ε of two losses that does not matter.
            seen: Where tests say what a source does on each axis, of the sources that they do not
                show in the whole band.

        Returns:
            The probabilities of `SelectionBelief.beaten`.
        """
        parts = {source: self._part(source, axes) for source, axes in seen.items()}
        return self.belief.beaten(leader, epsilon, parts)

    def _part(self, source: str, seen: Mapping[str, Seen]) -> FloatArray:
        """Return the part of a source's loss that was seen, shape (samples,)."""
        if self.coupled or self.belief.errors is not None:
            # A matrix, or an error that all axes leave, is seen where each of them is.
            return self.belief.part(source, *seen.values())
        axes = [(one, seen[axis].at(one.omega_rad_s)) for axis, one in self.by_axis.items()]
        return part_of_worst(source, axes)


class Comparison:
    """Compares the robots of a study by samples, the same ones until something new is known."""

    def __init__(
        self,
        plan: StudyPlan,
        settings: AdaptiveSettings,
        robots: Mapping[str, AxesKnowledge],
        rng: np.random.Generator,
    ) -> None:
        """Draw nothing yet.

        Args:
            plan: Robots, band, axes and motion.
            settings: Number of samples and of frequencies.
            robots: Knowledge of target and sources, by robot.
            rng: Generator that draws the samples.
        """
        self._plan, self._settings, self._robots, self._rng = plan, settings, robots, rng
        self.omega_rad_s = grid_rad_s(plan.band_rad_s, settings.grid_points)
        """Frequencies at which distances are computed, shape (grid,)."""
        self._spectra = spectra_of(plan)
        drawn = [next(iter(self._spectra.values())).omega_rad_s] if self._spectra else []
        self._drawn_rad_s = np.concatenate([self.omega_rad_s, *drawn])
        self._across: tuple[tuple[Coupling, ...], ErrorsAcross] | None = None
        self._draws: dict[tuple[str, str], tuple[int, ComplexArray]] = {}
        self._matrices: dict[str, tuple[list[ComplexArray], ComplexArray | None]] = {}

    def of(self, sources: Sequence[str]) -> Compared:
        """Compare the target with sources, all of which have been tested on at least one axis.

        Of many sources, only those are compared at every frequency that their tones leave a chance.
        An error on a trajectory has no such bound, and neither have distances of matrices.
        """
        several = len(self._plan.axes) > 1 or bool(self._spectra)
        if several or len(sources) <= self._settings.compared:
            return self._in_full(sources)
        return self._of_many(self._plan.axis, sources)

    def _of_many(self, axis: str, sources: Sequence[str]) -> Compared:
        """Compare sources until the tones of the others leave them no chance."""
        target = self._draw(self._plan.target)
        known = {name: self._robots[name].axes[axis].tones for name in sources}
        screened = Screened.of(self.omega_rad_s, target[axis], known, self._rng)
        step = self._settings.compared
        joining = [int(n) for n in np.argsort(screened.loss.mean(axis=1), kind="stable")[:step]]
        places: list[int] = []
        draws = {self._plan.target: target}
        belief: SelectionBelief | None = None
        while True:
            drawn = {sources[n]: self._draw(sources[n]) for n in joining}
            z = {name: one[axis] for name, one in drawn.items()}
            new = SelectionBelief.of(self.omega_rad_s, target[axis], z)
            belief = new if belief is None else belief.and_also(new)
            places += joining
            draws |= drawn
            leader, _ = belief.leader(self._settings.epsilon, self._settings.delta)
            ahead = belief.loss[belief.sources.index(leader)]
            chances = screened.ahead(ahead - self._settings.epsilon)
            chances[places] = 0.0
            likely = [int(n) for n in np.argsort(-chances, kind="stable") if chances[n] > 0.0]
            joining = likely[: min(step, self._settings.compared_max - len(places))]
            if not joining:
                break
        # Samples take megabytes for each robot.
        self._draws = {key: one for key, one in self._draws.items() if key[0] in draws}
        others = np.delete(np.arange(len(sources)), places)
        open_still = int(np.sum(screened.ahead(ahead)[others] > 0.0))
        finding = (
            f"{open_still} more sources may be as close as {leader}, as far as their tones tell: "
            f"the {len(places)} that are the most likely to be were compared between their tones"
        )
        belief = replace(belief, closest_other=screened.loss[others].min(axis=0, initial=np.inf))
        estimates = [screened.estimate(n, self._robots[sources[n]].tests) for n in others.tolist()]
        outrun = others[screened.outrun(ahead)[others]].tolist()
        return Compared(
            belief,
            {axis: belief},
            draws,
            (finding,) if open_still else (),
            {sources[n]: screened.reason(n, leader, ahead) for n in outrun},
            tuple(sorted(estimates, key=lambda one: one.psi)),
        )

    def _in_full(self, sources: Sequence[str]) -> Compared:
        draws = {name: self._draw(name) for name in (self._plan.target, *sources)}
        by_axis = self._by_axis(draws, sources)
        together = _together(by_axis, self._spectra)
        if len(self._plan.axes) == 1:
            return Compared(together, by_axis, draws, ())
        errors, findings = self._errors_across(together.errors, draws, sources)
        coupled, finding = self._coupled(draws, sources)
        findings = (finding, *findings)
        if coupled is None:
            return Compared(replace(together, errors=errors), by_axis, draws, findings)
        count = coupled.psi.shape[1]
        draws = {
            name: {axis: z[:count] for axis, z in drawn.items()} for name, drawn in draws.items()
        }
        if errors is not None:
            errors = replace(errors, parts=errors.parts[:, :count])
        belief = replace(coupled, errors=errors)
        return Compared(belief, by_axis, draws, findings, coupled=True)

    def _errors_across(
        self,
        errors: PredictedErrors | None,
        draws: Mapping[str, Draws],
        sources: Sequence[str],
    ) -> tuple[PredictedErrors | None, tuple[str, ...]]:
        """Add to errors on a trajectory what one axis of the target does to another."""
        if errors is None:
            return None, ()
        target = self._robots[self._plan.target]
        if self._across is None or self._across[0] != target.couplings:
            count = self._settings.samples
            drawn = ErrorsAcross.of(target, self._spectra, count, self._rng)
            self._across = target.couplings, drawn
        across = self._across[1]
        if not across.z:
            return errors, ()
        grid, motion = len(self.omega_rad_s), joined(self._spectra)
        parts = errors.parts.copy()
        for place, name in enumerate(sources):
            own = {axis: z[:, grid:] for axis, z in draws[name].items()}
            left = across.on(self._plan.axes, motion, own)
            pairs = left.reshape(len(left), -1, parts.shape[2])
            parts[place] += np.sum(np.abs(pairs) ** 2, axis=1)
        return replace(errors, parts=parts), (across.finding,)

    def _draw(self, name: str) -> Draws:
        """Return samples of a robot on every axis on which it was tested."""
        # Distances are compared over the band that is tested; a motion reaches far below it.
        draw = draw_resting if self._spectra else ResponseModel.draw
        drawn = {}
        for axis, known in self._robots[name].axes.items():
            if not known.tests:
                continue
            before = self._draws.get((name, axis))
            if before is None or before[0] != known.revision:
                z = draw(known.model, self._drawn_rad_s, self._settings.samples, self._rng)
                before = self._draws[name, axis] = known.revision, z
                if len(self._robots) > self._settings.compared:
                    known.forget_model()
            drawn[axis] = before[1]
        return drawn

    def _by_axis(
        self, draws: Mapping[str, Draws], sources: Sequence[str]
    ) -> dict[str, SelectionBelief]:
        beliefs = {}
        for axis in self._plan.axes:
            if all(axis in drawn for drawn in draws.values()):
                beliefs[axis] = SelectionBelief.of(
                    self.omega_rad_s,
                    draws[self._plan.target][axis],
                    {name: draws[name][axis] for name in sources},
                    self._spectra.get(axis),
                )
        return beliefs

    def _coupled(
        self, draws: Mapping[str, Draws], sources: Sequence[str]
    ) -> tuple[SelectionBelief | None, str]:
        """Return the belief about the distances of the matrices, and why it is or is not used.

        It is None where no axis answers to another one, and where a robot has axes that never
        played together.
        """
        robots = {name: self._robots[name] for name in draws}
        if not matters(robots):
            return None, "no axis answers to another, so that each is compared by itself"
        matrices: dict[str, ComplexArray] = {}
        for name, robot in robots.items():
            own, before = list(draws[name].values()), self._matrices.get(name)
            if before is None or list(map(id, before[0])) != list(map(id, own)):
                z = matrix_draws(robot, draws[name], self.omega_rad_s, self._rng)
                before = self._matrices[name] = own, z
            if before[1] is None:
                return None, (
                    "axes answer to each other, and not all of them were tested together: what "
                    "one does to another is not compared"
                )
            matrices[name] = before[1]
        others = {name: matrices[name] for name in sources}
        belief = coupled_belief(self.omega_rad_s, matrices[self._plan.target], others)
        return belief, (
            "axes answer to each other, so that distances are computed from the whole response "
            "matrices (their largest singular values)"
        )


def _together(
    by_axis: Mapping[str, SelectionBelief], spectra: Mapping[str, Spectrum]
) -> SelectionBelief:
    """Return the belief about the worst axis at every frequency, and the error on all axes."""
    one, *others = by_axis.values()
    if not others:
        return one
    psi, likeliest = one.psi, one.likeliest
    for other in others:
        psi = np.maximum(psi, other.psi)
        likeliest = np.maximum(likeliest, other.likeliest)
    errors = None
    if one.errors is not None:
        moved = sum(float(spectra[axis].power.sum()) for axis in by_axis)
        parts = np.zeros_like(one.errors.parts)
        for axis, belief in by_axis.items():
            if belief.errors is not None:
                parts += belief.errors.parts * (float(spectra[axis].power.sum()) / moved)
        errors = PredictedErrors(one.errors.omega_rad_s, parts)
    return replace(one, psi=psi, likeliest=likeliest, errors=errors)


def grid_rad_s(band_rad_s: tuple[float, float], points: int) -> FloatArray:
    """Return frequencies in rad/s that cover a band, half of them evenly, half by equal factors.

    Resonances are about as narrow, compared with their frequency, at the lower end of a band as at
    the upper one.
    """
    low, high = band_rad_s
    evenly = np.linspace(low, high, points - points // 2)
    by_factors = np.geomspace(low, high, points // 2 + 2)[1:-1]
    return np.sort(np.concatenate([evenly, by_factors]))
