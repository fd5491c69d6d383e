"""The stopping rule of the default algorithm, and the tests that it may choose."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class AdaptiveSettings:
    """The stopping rule, and the tests that the algorithm may choose."""

    delta: float = 0.05
    """Accepted probability δ of a wrong selection."""
    epsilon: float = 0.01
    """Difference ε of two chordal distances, or relative errors, that does not matter."""
    first_periods: int = 11
    """Least length of the first test's measuring part, in periods of the band's upper end."""
    share_of_settling: float = 0.5
    """Least length of the first test's measuring part, as a share of the settling time."""
    first_longest: float = 0.8
    """Most that this share requires, in periods of the band's lower end."""
    settle_share: float = 0.2
    """Share of a robot's settling time for which its tests wait, since what still rings then is
    estimated along with the tones."""
    settle_longest: float = 0.08
    settle_periods: float = 4.0
    """Most that tests of one axis as long as the first one wait, in periods of the band's lower end
    and in periods of its upper end, whichever is longer: in narrow bands, the former would leave
    even what decays soon."""
    lowest: float = 2.5
    """Highest that the lowest tone of a claim may be, as a multiple of the band's lower end; three
    for a first test that begins with its third harmonic."""
    other_amplitude: float = 0.5
    """Amplitude of that test, as a share of the largest that was played."""
    dear: float = 0.6
    """Share of the robot time from which the price of that test is a finding."""
    lengths: tuple[float, ...] = (1.0, 1.7, 3.0)
    """Lengths of later tests, as multiples of the first test's measuring time."""
    window_tones: int = 5
    """Number of tones in a test around one frequency."""
    contenders: int = 4
    """Number of rivals, the most probable winners, that are considered for tests in a round."""
    worth: float = 0.05
    """Least decrease of the probability of a wrong selection, as a share of it, for which robots
    are tested again while something is doubted that tests do not tell, or others are absent."""
    compared: int = 32
    """Number of sources, the closest at their tones, that are compared at every frequency; beyond
    it, only those are that their tones leave a chance."""
    compared_max: int = 160
    """Largest number of them. Others are held to be as close as their tones allow."""
    together: float = 0.5
    """Share of the best gain per second that another robot's test needs to join the round. If an
    absent robot's test would gain the most, the study ends where no other reaches this share."""
    simulated_cost: float = 0.01
    """Cost of a simulated robot's time, relative to that of a real one."""
    flight_error_max: float = 0.05
    """Error of flights, found by a test or between speeds, from which on no source is judged by
    flights alone."""
    samples: int = 600
    """Number of samples drawn from the belief about each robot's response."""
    grid_points: int = 256
    """Number of frequencies, over the band, at which distances are computed (`grid_rad_s`)."""
