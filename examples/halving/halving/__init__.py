"""Successive halving: all sources play a few tones, and the better half of them plays more."""

import math

import numpy as np

from nufleet.studies import (
    Excitation,
    Question,
    Report,
    SourceEstimate,
    StudyError,
    Tone,
    chordal_distance,
    chordal_variance,
)


class Halving:
    """A study that drops the further half of its sources after every round."""

    def __init__(self, plan, specs, rng):
        """Begin; the tones are spread over the band, from a random beginning."""
        self.plan, self.left, self.dropped = plan, list(plan.sources), {}
        self.order = list(plan.sources)
        self.rounds = min(plan.iterations, 1 + math.ceil(math.log2(len(plan.sources))))
        self.round, self.offset = 0, rng.uniform()
        self.responses, self.measured = {}, {source: {} for source in plan.sources}

    def ask(self):
        """Return the next round of tests; None when one source is left."""
        if self.round == self.rounds or (self.round and len(self.left) == 1):
            return None
        places = (np.arange(4) + (self.offset + self.round / self.rounds) % 1) / 4
        low, high = np.log(self.plan.band_rad_s)
        tones = tuple(
            Tone(omega_rad_s=float(omega)) for omega in np.exp(low + (high - low) * places)
        )
        test = Excitation(axis=self.plan.axis, tones=tones)
        self.asked = Question(self.round + 1, dict.fromkeys((self.plan.target, *self.left), test))
        return self.asked

    def tell(self, responses, failed):
        """Learn from the responses of the last round; return what is known after it."""
        self.round += 1
        if self.plan.target not in responses:
            raise StudyError(f"the target cannot be tested: {failed.get(self.plan.target)}")
        for robot, response in responses.items():
            self.responses.setdefault(robot, []).append(response)
        self.dropped |= {robot: reason for robot, reason in failed.items() if robot in self.left}
        played = [source for source in self.left if source in responses]
        if not played:
            raise StudyError("no source is left")
        target, sampled = responses[self.plan.target], {}
        for source in played:
            one = responses[source]
            psi = chordal_distance(target.z, one.z)
            variance = chordal_variance(target.z, target.variance, one.z, one.variance)
            found = zip(one.omega_rad_s, psi, np.sqrt(variance), strict=True)
            self.measured[source] |= {omega: (psi, std) for omega, psi, std in found}
            sampled[source] = float(psi.max())
        played.sort(key=lambda source: self.estimate(source).psi)
        self.left = played[: math.ceil(len(played) / 2)]
        # Sources that were dropped after fewer tones come after those that played more.
        self.order = played + [source for source in self.order if source not in played]
        known = (source for source in self.order if source not in self.dropped)
        return Report(
            iteration=self.asked.iteration,
            omega_rad_s=self.asked.omega_rad_s,
            responses=responses,
            sampled_psi=sampled,
            curves=(),
            ranking=tuple(self.estimate(source) for source in known),
            dropped=self.dropped,
        )

    def estimate(self, source):
        """Return the largest distance that was measured, with the error of that measurement."""
        measured = self.measured[source]
        omega = max(measured, key=lambda one: measured[one][0])
        psi, std = measured[omega]
        return SourceEstimate(
            robot=source,
            psi=float(psi),
            psi_low=float(max(0.0, psi - 1.96 * std)),
            psi_high=float(min(1.0, psi + 1.96 * std)),
            omega_rad_s=float(omega),
            tests=len(self.responses[source]),
            measured_psi=float(psi),
            measured_omega_rad_s=float(omega),
        )
