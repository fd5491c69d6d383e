"""A motion runs before all else where the machine grants it, and says once what is refused."""

from __future__ import annotations

import json
import os
import resource
import subprocess
import sys
import threading

import pytest

from nufleet.robot_agent.motion import promptness
from nufleet.robot_agent.motion.promptness import OTHERS_PRIORITY, PRIORITY, SWITCH_S, Promptness

MOVER, OTHER, CHOSEN, ENDED, STARTED, SECOND = 1, 2, 3, 4, 5, 6
NORMAL = (os.SCHED_OTHER, 0)
URGENT = (os.SCHED_FIFO, PRIORITY)
BEHIND = (os.SCHED_RR, OTHERS_PRIORITY)
OF_ITS_AUTHOR = (os.SCHED_FIFO, 50)


class Machine:
    """A machine with the rules of Linux for a process without rights beyond its limits."""

    def __init__(self) -> None:
        self.grants_priority = self.grants_memory = True
        self.policies = {MOVER: NORMAL, OTHER: NORMAL, SECOND: NORMAL, CHOSEN: OF_ITS_AUTHOR}
        self.flags = dict.fromkeys(self.policies, 0)
        self.running = MOVER
        self.locked = 0

    def threads(self, path: str) -> list[str]:
        assert path == "/proc/self/task"
        return [str(thread) for thread in (*self.policies, ENDED)]

    def policy(self, thread: int) -> int:
        if thread == ENDED:
            raise ProcessLookupError
        return self.policies[thread][0] | self.flags[thread]

    def parameter(self, thread: int) -> os.sched_param:
        return os.sched_param(self.policies[thread][1])

    def set_policy(self, thread: int, policy: int, parameter: os.sched_param) -> None:
        if thread == ENDED:
            raise ProcessLookupError
        flag, plain = policy & os.SCHED_RESET_ON_FORK, policy & ~os.SCHED_RESET_ON_FORK
        if (plain != os.SCHED_OTHER and not self.grants_priority) or flag < self.flags[thread]:
            raise PermissionError
        self.policies[thread] = (plain, parameter.sched_priority)
        self.flags[thread] = flag

    def memory_limit(self, which: int) -> tuple[int, int]:
        assert which == resource.RLIMIT_MEMLOCK
        return (resource.RLIM_INFINITY,) * 2 if self.grants_memory else (8 * 2**20,) * 2

    def lock(self, _flags: int) -> int:
        self.locked += 1
        return 0


@pytest.fixture
def machine(monkeypatch: pytest.MonkeyPatch) -> Machine:
    machine = Machine()
    monkeypatch.setattr(os, "listdir", machine.threads)
    monkeypatch.setattr(os, "sched_getscheduler", machine.policy)
    monkeypatch.setattr(os, "sched_getparam", machine.parameter)
    monkeypatch.setattr(os, "sched_setscheduler", machine.set_policy)
    monkeypatch.setattr(threading, "get_native_id", lambda: machine.running)
    monkeypatch.setattr(resource, "getrlimit", machine.memory_limit)
    library = type("Library", (), {"mlockall": staticmethod(machine.lock)})
    monkeypatch.setattr(promptness.ctypes, "CDLL", lambda _name: library)
    return machine


def test_a_process_moves_its_robots_before_all_other_work_during_motions_alone(
    machine: Machine, caplog: pytest.LogCaptureFixture
) -> None:
    prompt, before, switch_s = Promptness(), dict(machine.policies), sys.getswitchinterval()
    for _ in range(2):
        with prompt.motion():
            assert machine.policies == {
                MOVER: URGENT,
                OTHER: BEHIND,
                SECOND: BEHIND,
                CHOSEN: OF_ITS_AUTHOR,
            }
            assert sys.getswitchinterval() == pytest.approx(SWITCH_S)
        assert machine.policies == before
        assert sys.getswitchinterval() == switch_s
    assert machine.locked == 1
    assert not caplog.messages


def test_what_a_driver_starts_from_the_thread_that_moves_its_robot_does_not_delay_it(
    machine: Machine,
) -> None:
    with Promptness().motion():
        assert machine.flags == {MOVER: os.SCHED_RESET_ON_FORK, OTHER: 0, SECOND: 0, CHOSEN: 0}


def test_the_process_comes_first_until_none_of_its_robots_moves_any_more(machine: Machine) -> None:
    prompt, switch_s = Promptness(), sys.getswitchinterval()
    first, second = prompt.motion(), prompt.motion()
    first.__enter__()
    machine.running = SECOND
    second.__enter__()
    assert machine.policies[MOVER] == machine.policies[SECOND] == URGENT
    machine.running = MOVER
    first.__exit__(None, None, None)
    assert machine.policies[MOVER] == machine.policies[OTHER] == BEHIND
    assert machine.policies[SECOND] == URGENT
    assert sys.getswitchinterval() == pytest.approx(SWITCH_S)
    machine.running = SECOND
    second.__exit__(None, None, None)
    assert {*machine.policies.values()} == {NORMAL, OF_ITS_AUTHOR}
    assert sys.getswitchinterval() == switch_s


def test_a_thread_that_started_during_a_motion_is_normal_after_it(machine: Machine) -> None:
    with Promptness().motion():
        machine.policies[STARTED], machine.flags[STARTED] = machine.policies[OTHER], 0
    assert machine.policies[STARTED] == NORMAL


def test_a_motion_that_fails_leaves_nothing_behind(machine: Machine) -> None:
    before = dict(machine.policies)
    with pytest.raises(ZeroDivisionError), Promptness().motion():
        _ = 1 / 0
    assert machine.policies == before


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
    prompt, before = Promptness(), dict(machine.policies)
    for _ in range(3):
        with prompt.motion():
            assert (machine.policies == before) != priority
    (said,) = caplog.messages
    assert lacks in said
    assert "late by tens of milliseconds" in said
    assert f"LimitRTPRIO={PRIORITY} and LimitMEMLOCK=infinity" in said
    assert machine.locked == memory  # never below a limit, beyond which there would be none at all


MOTION = """
import json, os, threading
from nufleet.robot_agent.motion.promptness import Promptness

def policies():
    return [os.sched_getscheduler(int(one)) & ~os.SCHED_RESET_ON_FORK
            for one in os.listdir("/proc/self/task")]

ended = threading.Event()
threading.Thread(target=ended.wait).start()
with Promptness().motion():
    during = policies()
    if os.geteuid() == 0:
        os.seteuid(65534)  # as an agent that has no rights beyond its limits
after = policies()
ended.set()
print(json.dumps([during, after]))
"""


def test_linux_lets_a_process_without_further_rights_end_what_it_was_granted() -> None:
    ran = subprocess.run([sys.executable, "-c", MOTION], check=True, capture_output=True, text=True)
    during, after = json.loads(ran.stdout)
    granted = "no real-time priority" not in ran.stderr
    assert sorted(during) == ([os.SCHED_FIFO, os.SCHED_RR] if granted else [os.SCHED_OTHER] * 2)
    assert after == [os.SCHED_OTHER] * 2
