"""The faults of one simulation: a list drawn from a seed, which can be shortened."""

from __future__ import annotations

import random
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from benchmarks.faults.simulation.network import Weather

Kind = Literal[
    "kill agent",
    "freeze agent",
    "cut agent",
    "lose states",
    "late states",
    "bad sensor",
    "fill disk",
    "restart router",
    "kill orchestrator",
    "freeze orchestrator",
    "cut orchestrator",
    "interrupt",
    "set clock",
    "fill repository",
    "stop",
    "other repository",
    "second orchestrator",
    "cut motors",
    "bad health",
    "no health",
    "other version",
]

KINDS: tuple[tuple[Kind, int], ...] = (
    ("kill agent", 4),
    ("freeze agent", 4),
    ("cut agent", 3),
    ("lose states", 3),
    ("late states", 3),
    ("bad sensor", 3),
    ("fill disk", 1),
    ("restart router", 3),
    ("kill orchestrator", 3),
    ("freeze orchestrator", 2),
    ("cut orchestrator", 2),
    ("interrupt", 6),
    ("set clock", 2),
    ("fill repository", 1),
    ("stop", 2),
    ("other repository", 2),
    ("second orchestrator", 1),
)

KINDS_IN_THE_AIR: tuple[tuple[Kind, int], ...] = (
    ("cut motors", 6),
    ("bad health", 4),
    ("no health", 2),
    ("other version", 1),
    ("stop", 2),
    ("fill disk", 1),
    ("kill agent", 1),
    ("freeze agent", 1),
    ("other repository", 2),
)
"""Further faults of robots that take off, land and report their health."""

LAST_FAULT_S = 30.0


@dataclass(frozen=True)
class Fault:
    """One fault."""

    time_s: float
    """Time at which it happens, on the virtual clock."""

    kind: Kind
    """Kind of fault."""

    robot: int
    """Number of the robot that it concerns, from 1."""

    size: float
    """Duration in seconds, or size, depending on the kind."""

    def __str__(self) -> str:
        return f"{self.time_s:8.3f} {self.kind} r{self.robot} {self.size:.3f}"


@dataclass(frozen=True)
class Schedule:
    """The complete input of a simulation."""

    seed: int
    """Seed of every random number drawn during the simulation."""

    robots: int
    """Number of robots."""

    duration_max_s: float
    """Longest motion that the robots accept, in seconds."""

    weather: Weather
    """Quality of the network."""

    idle_s: float | None
    """Time after which the robots land; None for robots that neither take off nor report."""

    faults: tuple[Fault, ...]
    """Faults, in the order of their times."""


def drawn(seed: int) -> Schedule:
    """Return the schedule that belongs to a seed."""
    rng = random.Random(seed)  # noqa: S311 - a schedule is no secret
    robots = rng.choice((2, 2, 3, 4))
    weather = Weather()
    if rng.random() < 0.4:
        weather = Weather(
            lost=rng.choice((0.0, 0.01, 0.05)),
            doubled=rng.choice((0.0, 0.05)),
            late=rng.choice((0.0, 0.02, 0.1)),
            late_s=rng.choice((0.2, 2.0, 5.0)),
        )
    faults = [_fault(rng, robots, KINDS) for _ in range(rng.choice((0, 1, 1, 2, 2, 3, 4, 6)))]
    duration_max_s = rng.choice((7.0, 60.0))
    # Half of the schedules are as they were before robots could take off.
    more = random.Random(f"{seed} in the air")  # noqa: S311 - as above
    idle_s = more.choice((None, None, None, 0.3, 3.0, 20.0))
    if idle_s is not None:
        number = more.choice((1, 1, 2, 2, 3))
        faults += (_fault(more, robots, KINDS_IN_THE_AIR) for _ in range(number))
    faults.sort(key=lambda fault: fault.time_s)
    return Schedule(seed, robots, duration_max_s, weather, idle_s, tuple(faults))


def _fault(rng: random.Random, robots: int, among: Sequence[tuple[Kind, int]]) -> Fault:
    kinds, weights = zip(*among, strict=True)
    (kind,) = rng.choices(kinds, weights)
    size = rng.choice((0.2, 1.0, 2.0, 3.0, 5.0, 15.0)) * (0.5 + rng.random())
    # The moment at which the first goals are sent is the most critical: a quarter of the faults
    # fall on it.
    begins_s, lasts_s = rng.choice(
        ((0.2, 0.06), (0.0, 1.5), (0.0, LAST_FAULT_S), (0.0, LAST_FAULT_S))
    )
    time_s = begins_s + rng.random() * lasts_s
    return Fault(time_s, kind, rng.randrange(robots) + 1, size)
