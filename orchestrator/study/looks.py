"""The tests that a robot may play: a first look, looks at what is contested, and the lowest look.

Before anything is claimed, each contender has played a test that reaches down to the lower end of
the band, at another amplitude than its first: what differs below its lowest tone, or at another
amplitude, would otherwise be claimed unseen.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.study.adaptive_settings import AdaptiveSettings
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.orchestrator.study.tone_choice import (
    ToneChoice,
    closer_looks,
    first_look,
    lowest_look,
)
from nufleet.shared.arrays import ComplexArray, FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.multitone import largest_amplitudes

NOISY = 0.05
"""Standard deviation of estimates from which noise leaves no room for a smaller amplitude."""

REACHED = 1.25
"""Ratio of the lowest tone that a robot played to that of its lowest look from which that is due.
"""


class Looks:
    """The tests of all robots of a study, and what they cost."""

    def __init__(
        self, plan: StudyPlan, settings: AdaptiveSettings, robots: Mapping[str, RobotKnowledge]
    ) -> None:
        self._plan, self._settings, self._robots = plan, settings, robots
        self.first: dict[str, ToneChoice] = {}
        self.lowest: dict[str, ToneChoice] = {}
        for name, robot in robots.items():
            first = self.first[name] = first_look(
                plan.band_rad_s, robot.spec, settings.first_periods, settings.share_of_settling
            )
            self.lowest[name] = lowest_look(
                plan.band_rad_s, robot.spec, settings.lowest * plan.band_rad_s[0], first
            )
        self.asked_s = 0.0
        """Robot time of all tests that were asked for, in s."""
        self.lowest_asked_s = 0.0
        """The part of it that the lowest looks took."""

    def excitation(self, name: str, choice: ToneChoice) -> Excitation:
        """Return the excitation of a test that is to be played now, and count its time."""
        cost_s = self.duration_s(name, choice)
        self.asked_s += cost_s
        self.lowest_asked_s += cost_s * self._is_lowest(name, choice)
        amplitude = self._amplitude(name, choice)
        amplitudes = None if amplitude is None else (amplitude,)
        return choice.excitation(
            self._plan.axis, settle_s=self._settle_s(name), amplitudes=amplitudes
        )

    def duration_s(self, name: str, choice: ToneChoice) -> float:
        """Return the duration of a test in s."""
        return choice.duration_s(self._robots[name].spec, self._settle_s(name))

    def candidates(self, name: str, centres_rad_s: Sequence[float]) -> Iterator[ToneChoice]:
        """Yield the tests that the robot could play next, as far as it allows them.

        Args:
            name: Name of the robot.
            centres_rad_s: Frequencies in rad/s to look at more closely.
        """
        settings = self._settings
        looks = closer_looks(
            self._plan.band_rad_s,
            self.first[name].measure_s,
            settings.lengths,
            centres_rad_s,
            settings.window_tones,
        )
        for choice in (*looks, self.lowest[name]):
            if self.duration_s(name, choice) <= self._robots[name].spec.duration_max_s:
                yield choice

    def expected_variance(self, name: str, choice: ToneChoice) -> FloatArray:
        """Return the variances that a test's estimates are expected to have, shape (tones,)."""
        times_as_long = choice.measure_s / self.first[name].measure_s
        if self._amplitude(name, choice) is not None:
            times_as_long *= self._settings.other_amplitude**2
        return self._robots[name].expected_variance(choice.omega_rad_s, times_as_long)

    def expected(
        self, name: str, choice: ToneChoice, grid_rad_s: FloatArray, z: ComplexArray
    ) -> tuple[ComplexArray, FloatArray]:
        """Return what a test would measure, and the variances with which it would tell that.

        Args:
            name: Name of the robot.
            choice: Test.
            grid_rad_s: Frequencies of the samples in rad/s, shape (grid,).
            z: Samples of the robot's response there, shape (samples, grid or more).

        Returns:
            Samples at the tones, shape (samples, tones), and variances, shape (tones,).
        """
        # Samples exist on the grid only, so each tone takes them from the next grid point.
        at = np.searchsorted(grid_rad_s, choice.omega_rad_s).clip(0, len(grid_rad_s) - 1)
        doubt = self._robots[name].lasting_doubt(choice.omega_rad_s)
        return z[:, at], self.expected_variance(name, choice) + doubt

    def reached(self, name: str) -> bool:
        """Whether a test of the robot reached down to the lower end of the band."""
        lowest_rad_s = float(self.lowest[name].omega_rad_s[0])
        return self._robots[name].lowest_rad_s <= REACHED * lowest_rad_s

    def due(self, names: Iterable[str]) -> dict[str, ToneChoice]:
        """Return the lowest looks that are missing before anything is claimed."""
        return {name: self.lowest[name] for name in names if not self.reached(name)}

    def _settle_s(self, name: str) -> float:
        return self._settings.settle_share * self._robots[name].settling_time_s

    def _is_lowest(self, name: str, choice: ToneChoice) -> bool:
        return choice == self.lowest[name] != self.first[name]

    def _amplitude(self, name: str, choice: ToneChoice) -> float | None:
        """Return the amplitude of a test; None where the robot chooses it itself."""
        wanted, played = self._plan.amplitude, self._robots[name].amplitude
        if self._is_lowest(name, choice):
            wanted = None if played is None else self._settings.other_amplitude * played
            times_as_long = choice.measure_s / self.first[name].measure_s
            known = self._robots[name].expected_variance(choice.omega_rad_s, times_as_long)
            if np.median(known) > (self._settings.other_amplitude * NOISY) ** 2:
                wanted = None
        if wanted is None:
            return None
        tones = choice.excitation(self._plan.axis).tones
        axis = self._robots[name].spec.axis(self._plan.axis)
        return min(wanted, *largest_amplitudes([tones], [axis]))
