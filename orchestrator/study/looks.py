"""The tests that a robot may play: first looks, looks at what is contested, lowest and finer looks.

Before anything is claimed, each contender has played a test that reaches down to the lower end of
the band, at another amplitude than its first: what differs below its lowest tone, or at another
amplitude, would otherwise be claimed unseen. Its tones are mostly those of the first test, of which
a part is enough if that reaches as low. One that settles more slowly than it states, as tests of it
or of its kind showed, also plays the first look that it would have played. Before that, tests say
what it does near its tones only, and that it is at least as far away as there.

The first tests of several robots are short and share their tones, as most of these robots are told
apart by them. A target that alone lacks tests plays the lowest look in any case, and reaches down
at once where that is shorter.

Axes that may move together share the tones of a test, dealt to them in turn. Up to three of them
reach down to the lower end of the band in the same lowest look.
An axis that may not move with others on some robot is tested by itself on all of them, as their
responses to the same test are compared.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge, tone_spacing
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.seen import Seen
from nufleet.orchestrator.study.tone_choice import (
    LOW_SPACING,
    LOWEST_TOGETHER,
    ToneChoice,
    closer_looks,
    first_look,
    lowest_look,
    lowest_look_together,
    part_of,
)
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.duration import timing
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.multitone import largest_amplitudes
from nufleet.shared.robots.spec import RobotSpec

NOISY = 0.05
"""Standard deviation of estimates from which noise leaves no room for a smaller amplitude."""

FINER = 1.5
"""A test is repeated for resonances between its tones if these are as many times further apart."""

NEAR_A_TONE = 0.15
"""How far from a tone it is known what a robot does if resonances may lie between its tones, as a
share of their distance."""

CLAIMED = 2
"""Number of robots that a claim rests on, the target and the selected source. They play the lowest
looks; a first test that reaches as low saves some of these, and all that lack tests play it."""

ROUNDING = 1e-6
"""Share by which a tone may be higher than it was asked for."""


class Looks:
    """The tests of all robots of a study, and what they cost."""

    def __init__(
        self, plan: StudyPlan, settings: AdaptiveSettings, robots: Mapping[str, AxesKnowledge]
    ) -> None:
        self._plan, self._settings, self._robots = plan, settings, robots
        self._untested = sum(bool(robot.unseen) for robot in robots.values())
        """Number of robots that lacked tests when the study began."""
        specs = [robot.spec for robot in robots.values()]
        alone = [
            place
            for place, axis in enumerate(plan.axes)
            if not all(spec.axis(axis).together for spec in specs)
        ]
        together = tuple(place for place in range(len(plan.axes)) if place not in alone)
        groups = [group for group in (together, *((place,) for place in alone)) if group]
        self._alone = [plan.axes[place] for place in alone]
        self._why_alone = " may not move with another axis"
        try:
            self._firsts = {name: [self._first(name, group) for group in groups] for name in robots}
        except InvalidInputError as error:
            groups = [(place,) for place in range(len(plan.axes))]
            self._alone, self._why_alone = list(plan.axes), f", since {error}"
            self._firsts = {name: [self._first(name, group) for group in groups] for name in robots}
        self.first = {name: firsts[0] for name, firsts in self._firsts.items()}
        """First test of each robot, by name."""
        self.asked_s = 0.0
        """Robot time of all tests that were asked for, in s."""
        self.lowest_asked_s = 0.0
        """The part of it that the lowest looks took."""
        # A robot that answers at another amplitude than asked is not asked again.
        self._smaller_asked: set[tuple[str, int]] = set()

    @property
    def findings(self) -> tuple[str, ...]:
        """Which axes were tested by themselves, in words."""
        if not self._alone or len(self._plan.axes) == 1:
            return ()
        names = ", ".join(self._alone)
        return (f"tested one after the other: {names}{self._why_alone}",)

    def excitation(self, name: str, choice: ToneChoice) -> Excitation:
        """Return the excitation of a test that is to be played now, and count its time."""
        cost_s = self.duration_s(name, choice)
        self.asked_s += cost_s
        lower = choice.omega_rad_s[0] < self._first_of(name, choice.axes[0]).omega_rad_s[0]
        self.lowest_asked_s += cost_s * (choice.share is not None and bool(lower))
        if choice.share is not None and choice.share < 1:
            self._smaller_asked |= {(name, place) for place in choice.axes}
        return choice.excitation(
            *self._plan.axes,
            settle_s=self._settle_s(name, choice),
            amplitudes=self._amplitudes(name, choice),
        )

    def duration_s(self, name: str, choice: ToneChoice) -> float:
        """Return the duration of a test in s."""
        return choice.duration_s(self._robots[name].spec, self._settle_s(name, choice))

    def unseen(self, names: Iterable[str]) -> dict[str, ToneChoice]:
        """Return the first tests of axes that no test of a robot has played yet."""
        found = {}
        for name in names:
            missing = self._robots[name].unseen
            for first in self._firsts[name]:
                lacking = [place for place in first.axes if self._plan.axes[place] in missing]
                if name not in found and lacking:
                    found[name] = first
        return found

    def due(self, names: Iterable[str]) -> dict[str, ToneChoice]:
        """Return the looks at the lowest tones, or another amplitude, that a claim still lacks."""
        found = {}
        for name in names:
            for first in self._firsts[name]:
                lacking = self._lacking(name, first)
                look = self.lowest(name, first, lacking)
                if name not in found and (lacking or self._uncompared(name, look)):
                    found[name] = look
        return found

    def _uncompared(self, name: str, look: ToneChoice) -> bool:
        """Whether a look would be the first one at another amplitude of one of its axes."""
        if look.share is None or look.share >= 1:
            return False
        known = ((place, self._known(name, place)) for place in look.axes)
        return any(
            not one.at_two_amplitudes and (name, place) not in self._smaller_asked
            for place, one in known
        )

    def finer(self, names: Iterable[str]) -> dict[str, ToneChoice]:
        """Return the first tests as they would have been, had robots not misstated their settling.

        A resonance as narrow as its transient is slow may lie unseen between the tones played.
        """
        return {name: look for name in names for look, axes in self._finer(name) if look and axes}

    def coarse(self, name: str) -> tuple[str, ...]:
        """Return the axes between whose tones resonances may lie that only a finer look shows."""
        return tuple(self._plan.axes[place] for _, axes in self._finer(name) for place in axes)

    def unlooked(self, name: str) -> tuple[str, ...]:
        """Return the axes of a robot that settles slowly on which much may still be unseen.

        It misstated its settling, and between its tones, or below them, resonances as narrow as
        that were not looked for: what lies there can only make a distance larger.
        """
        if not self._robots[name].misstated:
            return ()
        below = {axis for first in self._firsts[name] for axis in self._lacking(name, first)}
        return tuple(dict.fromkeys((*self.coarse(name), *(self._plan.axes[n] for n in below))))

    def seen(self, name: str) -> dict[str, Seen]:
        """Return at which frequencies tests say what a robot does, by axis.

        It is empty where tests say it in the whole band.
        """
        robot, coarse = self._robots[name], self.coarse(name)
        lowest_rad_s = 0.0 if self.reached(name) else robot.lowest_rad_s
        if not coarse and not lowest_rad_s:
            return {}
        seen = dict.fromkeys(robot.axes, Seen.above(lowest_rad_s))
        for axis in coarse:
            known, place = robot.axes[axis], self._plan.axes.index(axis)
            # Stored tests may each be of a part of the band, so that no distance holds for all.
            first_rad_s = tone_spacing(self._first_of(name, place).omegas_of(place))
            within_rad_s = NEAR_A_TONE * min(
                known.spacing_rad_s(self._plan.band_rad_s), first_rad_s
            )
            seen[axis] = Seen.near(known.omega_rad_s, within_rad_s, lowest_rad_s)
        return seen

    def _finer(self, name: str) -> Iterator[tuple[ToneChoice | None, tuple[int, ...]]]:
        """Yield the finer looks of a robot, each with the places of the axes that lack it.

        It is None where the robot cannot move for as long as that takes.
        """
        robot = self._robots[name]
        if not robot.misstated:
            return
        slow = robot.spec.model_copy(update={"settling_time_s": robot.settling_time_s})
        for first in self._firsts[name]:
            try:
                look = self._first_look(slow, first.axes)
            except InvalidInputError:
                yield None, first.axes
                continue
            wanted = {axis: FINER * tone_spacing(look.omegas_of(axis)) for axis in look.axes}
            band_rad_s = self._plan.band_rad_s
            known = {axis: self._known(name, axis).spacing_rad_s(band_rad_s) for axis in look.axes}
            yield look, tuple(axis for axis in look.axes if known[axis] > wanted[axis])

    def lowest(
        self, name: str, first: ToneChoice, lacking: Sequence[int] | None = None
    ) -> ToneChoice:
        """Return the lowest look of a robot, of as many axes as may reach down together.

        It is played at another amplitude than the first test, if noise leaves room for a smaller
        one. Where that of a single axis reaches down itself, the look is a part of it.

        Args:
            name: Name of the robot.
            first: First test of the axes that play.
            lacking: Places of the axes that have not reached down yet; None for all of them. If
                there are none, only another amplitude is played.
        """
        look = self._lowest(name, first, first.axes if lacking is None else tuple(lacking))
        variances = [self._expected_variance(name, look, place) for place in look.axes]
        smaller = self._settings.other_amplitude
        quiet = np.median(np.concatenate(variances)) <= (smaller * NOISY) ** 2
        return replace(look, share=smaller if quiet else 1.0)

    def _lowest(self, name: str, first: ToneChoice, wanted: tuple[int, ...]) -> ToneChoice:
        spec, band_rad_s = self._robots[name].spec, self._plan.band_rad_s
        if len(first.axes) == 1:
            most_rad_s = self._wanted_rad_s * (1 + ROUNDING)
            look = lowest_look(spec, most_rad_s, first) if wanted else first
            return part_of(first) if look == first else look
        axes = (*wanted, *(axis for axis in first.axes if axis not in wanted))
        reach_rad_s = self._reach_rad_s(name, first)
        for low in range(min(len(wanted), max(LOWEST_TOGETHER)), 0, -1):
            together = lowest_look_together(band_rad_s, spec, reach_rad_s, axes, low)
            if together is not None:
                return together
        return replace(first, axes=axes)

    def candidates(self, name: str, centres_rad_s: Sequence[float]) -> Iterator[ToneChoice]:
        """Yield the tests that the robot could play next, as far as it allows them.

        Args:
            name: Name of the robot.
            centres_rad_s: Frequencies in rad/s to look at more closely.
        """
        for first in self._firsts[name]:
            looks = closer_looks(
                self._plan.band_rad_s,
                first.measure_s,
                self._settings.lengths,
                centres_rad_s,
                self._settings.window_tones,
                first.axes,
            )
            lowest = [self.lowest(name, first, [axis]) for axis in first.axes]
            lacking = self._lacking(name, first)
            lowest += [self.lowest(name, first, lacking[:n]) for n in range(2, len(lacking) + 1)]
            for choice in dict.fromkeys((*looks, *lowest)):
                if self.duration_s(name, choice) <= self._robots[name].spec.duration_max_s:
                    yield choice

    def expected(
        self,
        name: str,
        choice: ToneChoice,
        grid_rad_s: FloatArray,
        z: Mapping[str, ComplexArray],
    ) -> tuple[ComplexArray, FloatArray]:
        """Return what a test would measure, and the variances of these measurements.

        Args:
            name: Name of the robot.
            choice: Test.
            grid_rad_s: Frequencies of the samples in rad/s, shape (grid,).
            z: Samples of the robot's responses there, by axis, shape (samples, grid or more).

        Returns:
            Samples at all tones, shape (samples, tones), and variances, shape (tones,).
        """
        share = choice.share or 1.0
        measured, variances = [], []
        for place in choice.axes:
            omega = choice.omegas_of(place)
            # Samples exist on the grid only, so each tone takes them from the next grid point.
            at = np.searchsorted(grid_rad_s, omega).clip(0, len(grid_rad_s) - 1)
            measured.append(z[self._plan.axes[place]][:, at])
            doubt = self._known(name, place).lasting_doubt(omega)
            noise = self._expected_variance(name, choice, place)
            variances.append(noise / share**2 + doubt)
        return np.concatenate(measured, axis=1), np.concatenate(variances)

    def reached(self, name: str) -> bool:
        """Whether tests of the robot reached down to the lower end of the band on every axis."""
        return not any(self._lacking(name, first) for first in self._firsts[name])

    def _settle_s(self, name: str, choice: ToneChoice) -> float:
        """Return how long a test waits in s.

        In a test that measures for long, what still rings is told from the tones. In a shorter one
        it would change them, and pass for what another amplitude does. In a test of several axes,
        it is told from distortion by what does not repeat, for which the wait is needed.
        """
        settings, settling_s = self._settings, self._robots[name].settling_time_s
        low, high = self._plan.band_rad_s
        wait_s = settings.settle_share * settling_s
        long_s = min(settings.share_of_settling * settling_s, self._longest_s)
        if choice.measure_s < long_s or len(choice.axes) > 1:
            return wait_s
        most = max(settings.settle_longest / low, settings.settle_periods / high)
        return min(wait_s, 2 * math.pi * most)

    def _known(self, name: str, place: int) -> RobotKnowledge:
        return self._robots[name].axes[self._plan.axes[place]]

    def _expected_variance(self, name: str, choice: ToneChoice, place: int) -> FloatArray:
        """Return the variances on one axis at the amplitude of the first test, shape (tones,)."""
        first = self._first_of(name, place)
        known = self._known(name, place)
        return known.expected_variance(choice.omegas_of(place), choice.measure_s / first.measure_s)

    def _first_of(self, name: str, place: int) -> ToneChoice:
        """Return a robot's first test of an axis."""
        return next(one for one in self._firsts[name] if place in one.axes)

    def _lacking(self, name: str, first: ToneChoice) -> tuple[int, ...]:
        """Return the axes of a test that have not reached down to the lower end of the band."""
        most_rad_s = self._reach_rad_s(name, first) * (1 + ROUNDING)
        return tuple(
            axis for axis in first.axes if self._known(name, axis).lowest_rad_s > most_rad_s
        )

    def _reach_rad_s(self, name: str, first: ToneChoice) -> float:
        """Return the frequency in rad/s that a tone of each axis must not be above for a claim.

        It is as low as the robot allows.
        """
        band_rad_s, spec = self._plan.band_rad_s, self._robots[name].spec
        reach_rad_s, already_rad_s = self._wanted_rad_s, float(first.omega_rad_s[0])
        if len(first.axes) == 1:
            return max(reach_rad_s, float(lowest_look(spec, reach_rad_s, first).omega_rad_s[0]))
        while (
            reach_rad_s < already_rad_s
            and lowest_look_together(band_rad_s, spec, reach_rad_s, first.axes, 1) is None
        ):
            reach_rad_s *= LOW_SPACING
        return reach_rad_s

    @property
    def _wanted_rad_s(self) -> float:
        """Frequency in rad/s that the lowest tone must not be above, of robots that allow it."""
        return self._settings.lowest * self._plan.band_rad_s[0]

    @property
    def _longest_s(self) -> float:
        """Most that a settling time requires of a first test, in s."""
        return self._settings.first_longest * 2 * math.pi / self._plan.band_rad_s[0]

    def _first_look(
        self, spec: RobotSpec, axes: tuple[int, ...], lowest_rad_s: float = math.inf
    ) -> ToneChoice:
        return first_look(
            self._plan.band_rad_s,
            spec,
            self._settings.first_periods,
            self._settings.share_of_settling,
            axes,
            lowest_rad_s,
            self._longest_s,
        )

    def _first(self, name: str, group: tuple[int, ...]) -> ToneChoice:
        """Return a first test: one that reaches down to the lower end where that saves time."""
        spec = self._robots[name].spec
        first = self._first_look(spec, group)
        if len(group) == 1 and self._untested > 1:
            return first
        reach_rad_s = self._reach_rad_s(name, first)
        deeper = self._first_look(spec, group, reach_rad_s)
        share_claimed = min(1.0, CLAIMED / max(1, self._untested))

        def price_s(one: ToneChoice) -> float:
            most_rad_s = reach_rad_s * (1 + ROUNDING)
            lacking = tuple(axis for axis in group if one.omegas_of(axis)[0] > most_rad_s)
            look = self._lowest(name, one, lacking)
            looks_s = self.duration_s(name, look)
            while lacking := tuple(a for a in lacking[1:] if look.omegas_of(a)[0] > most_rad_s):
                look = self._lowest(name, one, lacking)
                looks_s += self.duration_s(name, look)
            return self.duration_s(name, one) + share_claimed * looks_s

        return min(first, deeper, key=price_s)

    def _amplitudes(self, name: str, choice: ToneChoice) -> tuple[float, ...] | None:
        """Return the amplitudes of a test; None where the robot chooses them itself.

        No amplitude exceeds that of the study: who states a small one wants no larger motion.
        """
        axes = [self._plan.axes[place] for place in choice.axes]
        task = self._plan.amplitude
        wanted = [task for _ in axes]
        if choice.share is not None and choice.share < 1:
            largest = math.inf if task is None else task
            played = [self._known(name, place).amplitude for place in choice.axes]
            wanted = [task if one is None else min(choice.share * one, largest) for one in played]
        if all(one is None for one in wanted):
            return None
        test, spec = choice.excitation(*self._plan.axes), self._robots[name].spec
        tones, limits = [one.tones for one in test.played], [spec.axis(axis) for axis in axes]
        most = largest_amplitudes(tones, limits, choice.base_rad_s, timing(test, spec).ramp_s)
        return tuple(
            limit if one is None else min(one, limit)
            for one, limit in zip(wanted, most, strict=True)
        )
