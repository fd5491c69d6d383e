"""How long stops and interrupts take from their sender to robots that move and stream."""

from __future__ import annotations

import tempfile
import time
from collections import Counter
from pathlib import Path
from threading import Semaphore

import numpy as np

from benchmarks.faults.figure import Figure
from benchmarks.faults.lab import Lab, opened_lab
from benchmarks.faults.logbook import TOLD_TO_REST
from benchmarks.faults.program import wait_until
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.orchestrator.jobs.stop import stop_robots
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import GoalRequest

STOP_MAX_S = 0.02
INTERRUPT_MAX_S = 0.2
COMMAND_MAX_S = 0.6
COMMANDS = 10
PROCESSES = 4
LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=600.0)


def figures(robots: int, rounds: int) -> list[Figure]:
    """In each round, stop each robot by itself, and then all of them together."""
    names = tuple(f"r{k}" for k in range(robots))
    with tempfile.TemporaryDirectory() as folder, opened_lab(Path(folder)) as lab:
        lab.describe_section_v(dict.fromkeys(names, 0.9))
        lab.router()
        for start in range(PROCESSES):
            lab.agent(*names[start::PROCESSES], realtime=1.0)
        fleet = lab.orchestrator(*names)
        streamed: Counter[str] = Counter()
        fleet.observe_telemetry(lambda robot, samples: streamed.update([robot]))
        alone, together = [], []
        for number in range(rounds):
            _all_move(lab, fleet, names, f"alone-{number}")
            alone += [_stopped_s(lab, fleet, name) for name in names]
            _all_move(lab, fleet, names, f"together-{number}")
            together.append(_all_stopped_s(lab, fleet, names))
        interrupted = [
            _interrupted_s(lab, fleet, names, f"interrupted-{number}") for number in range(rounds)
        ]
        typed = []
        for number in range(COMMANDS):
            _all_move(lab, fleet, names, f"typed-{number}")
            typed.append(_stopped_by_command_s(lab, names))
    return [
        Figure(
            f"a stop is with its robot after, {robots} moving (p99)",
            float(np.quantile(alone, 0.99)),
            "s",
            STOP_MAX_S,
            {
                "median": f"{1e3 * float(np.median(alone)):.2f} ms",
                "worst": f"{1e3 * max(alone):.2f} ms",
                "stops": len(alone),
                "batches streamed meanwhile": streamed.total(),
            },
        ),
        Figure(
            f"a stop of all {robots} is with the last robot after (worst)",
            max(together),
            "s",
            None,
            {"median": f"{1e3 * float(np.median(together)):.2f} ms", "stops": len(together)},
        ),
        Figure(
            f"an interrupt (Ctrl-C) is with the last of {robots} after (worst)",
            max(interrupted),
            "s",
            INTERRUPT_MAX_S,
            {
                "median": f"{1e3 * float(np.median(interrupted)):.2f} ms",
                "interrupts": len(interrupted),
            },
        ),
        Figure(
            f"from Enter behind `nufleet stop --all` to the last of {robots} (median)",
            float(np.median(typed)),
            "s",
            COMMAND_MAX_S,
            {"worst": f"{max(typed):.2f} s", "commands": len(typed)},
        ),
    ]


def _all_move(lab: Lab, fleet: Fleet, names: tuple[str, ...], goal_id: str) -> None:
    for name in names:
        fleet.release(name)
        fleet.submit(name, GoalRequest(goal_id=goal_id, owner=fleet.orchestrator_id, motion=LONG))
    for name in names:
        lab.wait_for_state(
            fleet, name, lambda state: state.goal_id == goal_id and state.progress > 0
        )


def _stopped_s(lab: Lab, fleet: Fleet, name: str) -> float:
    began_s = time.monotonic()
    fleet.stop(name, "measuring")
    return _told_s(lab, name, began_s)


def _all_stopped_s(lab: Lab, fleet: Fleet, names: tuple[str, ...]) -> float:
    began_s = time.monotonic()
    fleet.stop_everyone("measuring")
    slowest_s = max(_told_s(lab, name, began_s) for name in names)
    if stop_robots(fleet, names, "measuring"):
        raise AssertionError("a robot did not confirm its stop")
    return slowest_s


def _interrupted_s(lab: Lab, fleet: Fleet, names: tuple[str, ...], goal_id: str) -> float:
    goals, over = GoalRunner(fleet), Semaphore(0)
    with goals.pursuing() as loop:
        for name in names:
            fleet.release(name)
            loop.begin(goals.errand(name, goal_id, LONG, on_ended=lambda _: over.release()))
        for name in names:
            lab.wait_for_state(
                fleet, name, lambda state: state.goal_id == goal_id and state.progress > 0
            )
        began_s = time.monotonic()
        goals.interrupt()
        slowest_s = max(_told_s(lab, name, began_s) for name in names)
        for _ in names:
            over.acquire()
    return slowest_s


def _stopped_by_command_s(lab: Lab, names: tuple[str, ...]) -> float:
    began_s = time.monotonic()
    stop = lab.command("stop", "--all", "--connect", lab.endpoint)
    slowest_s = max(_told_s(lab, name, began_s) for name in names)
    if stop.wait() != 0:
        raise AssertionError(f"a robot did not confirm its stop: {stop.said}")
    return slowest_s


def _told_s(lab: Lab, name: str, began_s: float) -> float:
    """Return how long after the sender began the robot itself was told, by its own logbook."""

    def told() -> list[float]:
        entries = lab.logbook(name)
        return [e.time_s for e in entries if e.what == TOLD_TO_REST and e.time_s > began_s]

    wait_until(lambda: bool(told()))
    return told()[0] - began_s
