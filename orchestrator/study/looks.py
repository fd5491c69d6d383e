"""The tests that a robot may play: a first look, looks at what is contested, and the lowest look.

Before anything is claimed, each contender has played a test that reaches down to the lower end of
the band, at another amplitude than its first: what differs below its lowest tone, or at another
amplitude, would otherwise be claimed unseen.

Axes that may move together share the tones of a test, dealt to them in turn. The axis that plays
the lowest tone changes from test to test, until each has reached down to the lower end of the band.
An axis that may not move with others on some robot is tested by itself on all of them, as their
responses to the same test are compared.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.tone_choice import (
    ToneChoice,
    closer_looks,
    first_look,
    lowest_look,
    turns_of,
)
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.multitone import largest_amplitudes

NOISY = 0.05
"""Standard deviation of estimates from which noise leaves no room for a smaller amplitude."""

REACHED = 1.25
"""A lowest look is due once the lowest tone played exceeds that of the lowest look by this
factor."""

CLAIMED = 2
"""Number of robots that a claim rests on, the target and the selected source. They play the lowest
look once for each axis; where it comes first, it is one of these, and all other robots play it."""


class Looks:
    """The tests of all robots of a study, and what they cost."""

    def __init__(
        self, plan: StudyPlan, settings: AdaptiveSettings, robots: Mapping[str, AxesKnowledge]
    ) -> None:
        self._plan, self._settings, self._robots = plan, settings, robots
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
        self.lowest = {
            name: tuple(self._lowest_of(name, first) for first in firsts)
            for name, firsts in self._firsts.items()
        }
        """Lowest looks of each robot: one of the axes that move together, one of each other."""
        self.first = {name: firsts[0] for name, firsts in self._firsts.items()}
        """First test of each robot, by name."""
        self.asked_s = 0.0
        """Robot time of all tests that were asked for, in s."""
        self.lowest_asked_s = 0.0
        """The part of it that the lowest looks took."""

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
        self.lowest_asked_s += cost_s * self._is_lowest(name, choice)
        return choice.excitation(
            *self._plan.axes,
            settle_s=self._settle_s(name),
            amplitudes=self._amplitudes(name, choice),
        )

    def duration_s(self, name: str, choice: ToneChoice) -> float:
        """Return the duration of a test in s."""
        return choice.duration_s(self._robots[name].spec, self._settle_s(name))

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
        """Return the lowest looks that are missing before anything is claimed."""
        found = {}
        for name in names:
            for lowest in self.lowest[name]:
                least_rad_s = _reached(lowest.axes) * float(lowest.omega_rad_s[0])
                reached = {axis: self._known(name, axis).lowest_rad_s for axis in lowest.axes}
                axis = max(reached, key=lambda place: reached[place])
                if name not in found and reached[axis] > least_rad_s:
                    found[name] = _led_by(lowest, axis)
        return found

    def candidates(self, name: str, centres_rad_s: Sequence[float]) -> Iterator[ToneChoice]:
        """Yield the tests that the robot could play next, as far as it allows them.

        Args:
            name: Name of the robot.
            centres_rad_s: Frequencies in rad/s to look at more closely.
        """
        for first, lowest in zip(self._firsts[name], self.lowest[name], strict=True):
            looks = closer_looks(
                self._plan.band_rad_s,
                first.measure_s,
                self._settings.lengths,
                centres_rad_s,
                self._settings.window_tones,
                first.axes,
            )
            for choice in (*looks, *(_led_by(lowest, axis) for axis in lowest.axes)):
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
        share = self._settings.other_amplitude if self._smaller(name, choice) else 1.0
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
        return not self.due([name])

    def _settle_s(self, name: str) -> float:
        return self._settings.settle_share * self._robots[name].settling_time_s

    def _known(self, name: str, place: int) -> RobotKnowledge:
        return self._robots[name].axes[self._plan.axes[place]]

    def _expected_variance(self, name: str, choice: ToneChoice, place: int) -> FloatArray:
        """Return the variances on one axis at the amplitude of the first test, shape (tones,)."""
        first = next(one for one in self._firsts[name] if place in one.axes)
        known = self._known(name, place)
        return known.expected_variance(choice.omegas_of(place), choice.measure_s / first.measure_s)

    def _smaller(self, name: str, choice: ToneChoice) -> bool:
        """Whether a test is played at another amplitude, as lowest looks are if noise allows."""
        if not self._is_lowest(name, choice):
            return False
        variances = [self._expected_variance(name, choice, place) for place in choice.axes]
        quiet = (self._settings.other_amplitude * NOISY) ** 2
        return bool(np.median(np.concatenate(variances)) <= quiet)

    def _is_lowest(self, name: str, choice: ToneChoice) -> bool:
        """Whether a test is a lowest look that is not the robot's first test as well."""
        lowest = any(choice in turned(one) for one in self.lowest[name])
        return lowest and choice not in self._firsts[name]

    def _first(self, name: str, group: tuple[int, ...]) -> ToneChoice:
        spec, settings, band_rad_s = self._robots[name].spec, self._settings, self._plan.band_rad_s
        first = first_look(
            band_rad_s, spec, settings.first_periods, settings.share_of_settling, group
        )
        lowest = self._lowest_of(name, first)
        lowest_s, first_s = lowest.duration_s(spec), first.duration_s(spec)
        cheaper = 0 <= len(self._robots) * (lowest_s - first_s) <= CLAIMED * lowest_s
        return lowest if len(group) > 1 and cheaper else first

    def _lowest_of(self, name: str, first: ToneChoice) -> ToneChoice:
        lowest_rad_s = self._settings.lowest * self._plan.band_rad_s[0]
        # Each axis needs a test of its own for this tone, which is the shorter the higher it is.
        lowest_rad_s *= REACHED / _reached(first.axes)
        spec = self._robots[name].spec
        return lowest_look(self._plan.band_rad_s, spec, lowest_rad_s, first, first.axes)

    def _amplitudes(self, name: str, choice: ToneChoice) -> tuple[float, ...] | None:
        """Return the amplitudes of a test; None where the robot chooses them itself."""
        axes = [self._plan.axes[place] for place in choice.axes]
        wanted = [self._plan.amplitude] * len(axes)
        if self._is_lowest(name, choice):
            wanted = [None] * len(axes)
            if self._smaller(name, choice):
                share = self._settings.other_amplitude
                played = [self._known(name, place).amplitude for place in choice.axes]
                wanted = [None if one is None else share * one for one in played]
        if all(one is None for one in wanted):
            return None
        tones = [one.tones for one in choice.excitation(*self._plan.axes).played]
        spec = self._robots[name].spec
        most = largest_amplitudes(tones, [spec.axis(axis) for axis in axes])
        return tuple(
            limit if one is None else min(one, limit)
            for one, limit in zip(wanted, most, strict=True)
        )


def _reached(axes: tuple[int, ...]) -> float:
    """Return how much higher than in its lowest look an axis may have played its lowest tone.

    A lowest look of several axes uses that margin itself.
    """
    return REACHED if len(axes) == 1 else 1.0 + 1e-6


def turned(choice: ToneChoice) -> list[ToneChoice]:
    """Return a test with each of its axes in turn as the one that plays the lowest tone."""
    return [_led_by(choice, axes[0]) for axes in turns_of(choice.axes)]


def _led_by(choice: ToneChoice, axis: int) -> ToneChoice:
    at = choice.axes.index(axis)
    return replace(choice, axes=choice.axes[at:] + choice.axes[:at])
