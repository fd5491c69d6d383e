"""Selects the tone at which responses are compared in the views that show one tone."""

from __future__ import annotations

from nufleet.orchestrator.viewer.events import Answers


def telling_tone(answers: Answers) -> float:
    """Return the latest tone at which the leading sources are farthest from the target, in rad/s.

    The distance is the sum of the chordal distances ψ(z_S, z_T) over the leading sources. Tones
    that more of them have responded to come first: sources whose stored responses replace tests
    share few tones with the target. Where they share none of the latest, earlier ones count.

    Args:
        answers: Responses to compare.

    Returns:
        The frequency; without anything to compare, the lowest of the latest tones, or 0.
    """
    psi = [answers.psi(source) for source in answers.leaders]

    def farness(omega_rad_s: float) -> tuple[int, float]:
        known = [one[omega_rad_s] for one in psi if omega_rad_s in one]
        return len(known), sum(known)

    compared = set().union(*psi)
    tones = compared.intersection(answers.omega_rad_s) or compared or answers.omega_rad_s
    return max(sorted(tones), key=farness, default=0.0)


def responses_at(answers: Answers, omega_rad_s: float) -> dict[str, complex]:
    """Return the response z(ω) at a tone, by robot that responded to it."""
    return {robot: z[omega_rad_s] for robot, z in answers.responses.items() if omega_rad_s in z}
