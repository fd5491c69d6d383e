"""How soon it is noticed that an agent was killed, frozen or cut off, and its robot rests."""

from __future__ import annotations

import os
import signal
import tempfile
import time
from pathlib import Path

from benchmarks.faults.figure import Figure
from benchmarks.faults.lab import Lab, opened_lab
from benchmarks.faults.namespaces import star
from benchmarks.faults.program import PATIENCE_S, Program, wait_until
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import GoalRequest

KILLED_MAX_S = 0.05
SILENT_MAX_S = 2.5
LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)


def figures(kills: int, silences: int) -> list[Figure]:
    """Measure `kills` kills of an agent, and `silences` freezes and partitions each."""
    with tempfile.TemporaryDirectory() as folder, opened_lab(Path(folder)) as lab, star("a") as net:
        lab.describe_section_v({"a": 0.9})
        lab.router("tcp/0.0.0.0:7447", namespace=net.hub)
        cable = net.cables["a"]
        agent = lab.agent(
            "a", connect=f"tcp/{net.hub_address('a')}:7447", realtime=1.0, namespace=cable.far
        )
        fleet = lab.orchestrator("a")
        killed = [_killed(fleet, agent) for _ in range(kills)]
        frozen = [_frozen(fleet, agent) for _ in range(silences)]
        noticed, rested = [], []
        for number in range(silences):
            fleet.submit(
                "a", GoalRequest(goal_id=f"g{number}", owner=fleet.orchestrator_id, motion=LONG)
            )
            lab.wait_for_state(fleet, "a", lambda state: state.progress > 0)
            began_s = time.monotonic()
            cable.pull()
            noticed.append(_gone_s(fleet, began_s))
            rested.append(_rested_s(lab, began_s))
            cable.plug_in()
            fleet.wait_for(("a",), timeout_s=PATIENCE_S)
    return [
        _figure("a killed agent is noticed after", killed, KILLED_MAX_S),
        _figure("a frozen agent is noticed after", frozen, SILENT_MAX_S),
        _figure("a partition is noticed by the orchestrator after", noticed, SILENT_MAX_S),
        _figure("a robot that is cut off from its owner rests after", rested, SILENT_MAX_S),
    ]


def _killed(fleet: Fleet, agent: Program) -> float:
    began_s = time.monotonic()
    os.kill(agent.pid, signal.SIGKILL)
    noticed_s = _gone_s(fleet, began_s)
    agent.kill()
    agent.start()
    fleet.wait_for(("a",), timeout_s=PATIENCE_S)
    return noticed_s


def _frozen(fleet: Fleet, agent: Program) -> float:
    began_s = time.monotonic()
    agent.freeze()
    noticed_s = _gone_s(fleet, began_s)
    agent.thaw()
    fleet.wait_for(("a",), timeout_s=PATIENCE_S)
    return noticed_s


def _gone_s(fleet: Fleet, began_s: float) -> float:
    if not fleet.watch("a").wait_until(lambda w: not w.alive, timeout_s=PATIENCE_S):
        raise AssertionError("it was never noticed")
    return time.monotonic() - began_s


def _rested_s(lab: Lab, began_s: float) -> float:
    wait_until(lambda: lab.motions("a")[-1].ended_s is not None)
    ended_s = lab.motions("a")[-1].ended_s
    return (ended_s or began_s) - began_s


def _figure(name: str, seconds: list[float], limit_s: float) -> Figure:
    ordered = sorted(seconds)
    details = {
        "median": f"{ordered[len(ordered) // 2]:.3g} s",
        "least": f"{ordered[0]:.3g} s",
        "times": len(ordered),
    }
    return Figure(f"{name} (worst)", ordered[-1], "s", limit_s, details)
