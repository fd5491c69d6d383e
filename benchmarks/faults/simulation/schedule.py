"""What goes wrong in one simulation, drawn from its seed: a list of faults that can be shortened."""

from __future__ import annotations

import random
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

LAST_FAULT_S = 30.0


@dataclass(frozen=True)
class Fault:
    """One thing that goes wrong: when, to which robot, for how long or by how much."""

    time_s: float
    kind: Kind
    robot: int
    size: float

    def __str__(self) -> str:
        return f"{self.time_s:8.3f} {self.kind} r{self.robot} {self.size:.3f}"


@dataclass(frozen=True)
class Schedule:
    """All that a simulation is made from."""

    seed: int
    robots: int
    duration_max_s: float
    weather: Weather
    faults: tuple[Fault, ...]


def drawn(seed: int) -> Schedule:
    """Return the schedule of a seed."""
    rng = random.Random(seed)
    robots = rng.choice((2, 2, 3, 4))
    weather = Weather()
    if rng.random() < 0.4:
        weather = Weather(
            lost=rng.choice((0.0, 0.01, 0.05)),
            doubled=rng.choice((0.0, 0.05)),
            late=rng.choice((0.0, 0.02, 0.1)),
            late_s=rng.choice((0.2, 2.0, 5.0)),
        )
    faults = tuple(_fault(rng, robots) for _ in range(rng.choice((0, 1, 1, 2, 2, 3, 4, 6))))
    return Schedule(
        seed,
        robots,
        rng.choice((7.0, 60.0)),
        weather,
        tuple(sorted(faults, key=lambda fault: fault.time_s)),
    )


def _fault(rng: random.Random, robots: int) -> Fault:
    kinds, weights = zip(*KINDS, strict=True)
    (kind,) = rng.choices(kinds, weights)
    size = rng.choice((0.2, 1.0, 2.0, 3.0, 5.0, 15.0)) * (0.5 + rng.random())
    # Most interesting is what happens around the moment a goal is sent.
    time_s = rng.random() * (1.5 if rng.random() < 0.3 else LAST_FAULT_S)
    return Fault(time_s, kind, rng.randrange(robots) + 1, size)
