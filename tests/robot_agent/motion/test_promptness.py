"""A motion runs before all else where the machine grants it, and says once what is refused."""

from __future__ import annotations

import os
import resource

import pytest

from nufleet.robot_agent.motion import promptness
from nufleet.robot_agent.motion.promptness import PRIORITY, Promptness


class Machine:
    """A machine that grants what it is told to, and notes what it was asked for."""

    def __init__(self) -> None:
        self.grants_priority = self.grants_memory = True
        self.policies: list[tuple[int, int]] = []
        self.locked = 0

    def set_policy(self, thread: int, policy: int, parameter: os.sched_param) -> None:
        assert thread == 0  # the calling one
        if not self.grants_priority:
            raise PermissionError
        self.policies.append((policy, parameter.sched_priority))

    def memory_limit(self, which: int) -> tuple[int, int]:
        assert which == resource.RLIMIT_MEMLOCK
        return (resource.RLIM_INFINITY,) * 2 if self.grants_memory else (8 * 2**20,) * 2

    def lock(self, _flags: int) -> int:
        self.locked += 1
        return 0


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    machine = Machine()
    monkeypatch.setattr(os, "sched_setscheduler", machine.set_policy)
    monkeypatch.setattr(resource, "getrlimit", machine.memory_limit)
    library = type("Library", (), {"mlockall": staticmethod(machine.lock)})
    monkeypatch.setattr(promptness.ctypes, "CDLL", lambda _name: library)
    return machine


def test_a_thread_runs_before_all_others_during_its_motions_alone(
    machine: Machine, caplog: pytest.LogCaptureFixture
) -> None:
    prompt = Promptness()
    urgent = (os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, PRIORITY)
    for _ in range(2):
        with prompt.motion():
            assert machine.policies[-1] == urgent
        assert machine.policies[-1] == (os.SCHED_OTHER, 0)
    assert machine.locked == 1
    assert not caplog.messages


@pytest.mark.parametrize(
    ("priority", "memory", "lacks"),
    [
        (False, True, "grants no real-time priority:"),
        (True, False, "grants no locked memory:"),
        (False, False, "grants no real-time priority and no locked memory:"),
    ],
)
def test_what_is_not_granted_is_said_once_with_what_it_costs_and_how_to_grant_it(
    priority: bool,
    memory: bool,
    lacks: str,
    machine: Machine,
    caplog: pytest.LogCaptureFixture,
) -> None:
    machine.grants_priority, machine.grants_memory = priority, memory
    prompt = Promptness()
    for _ in range(3):
        with prompt.motion():
            pass
    (said,) = caplog.messages
    assert lacks in said
    assert "late by tens of milliseconds" in said
    assert f"LimitRTPRIO={PRIORITY} and LimitMEMLOCK=infinity" in said
    assert machine.locked == memory  # never below a limit, beyond which there would be none at all
