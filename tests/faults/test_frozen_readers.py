"""A computer that hangs while its link is full holds up no robot's stop."""

from __future__ import annotations

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager

import psutil
import zenoh
from fleet_lab import submitted

from benchmarks.faults.lab import KEYS, Lab
from benchmarks.faults.program import PATIENCE_S, wait_until
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.frame import stop_frame
from nufleet.shared.wire.messages import GoalRequest
from nufleet.shared.wire.transport import open_client

LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)
STOP = stop_frame("desk", "smoke", order_id="1")

READER = """
import sys
from nufleet.shared.wire import transport

transport.LEASE_MS = 3_600_000  # its silence alone never ends its link
with transport.open_client(sys.argv[1], timeout_s=120.0) as session:
    session.subscribe("nufleet/lab/robot/b/**", lambda *_: None, max_bytes=100_000)
    session.declare_alive("nufleet/lab/robot/b/alive")
    print("reads", flush=True)
    sys.stdin.read()
"""


@contextmanager
def frozen_reader(endpoint: str, fleet: Fleet) -> Iterator[None]:
    """Have a program be robot b, and freeze it once the fleet sees it: it reads no longer."""
    with subprocess.Popen(
        [sys.executable, "-c", READER, endpoint], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    ) as program:
        assert program.stdout is not None
        assert program.stdout.readline() == b"reads\n"
        process = psutil.Process(program.pid)
        try:
            # What it has declared may not have left it yet, and would stay in it if it froze now.
            fleet.wait_for(("b",), timeout_s=PATIENCE_S)
            process.suspend()
            wait_until(lambda: process.status() == psutil.STATUS_STOPPED)
            yield
        finally:
            process.kill()


def test_a_stop_behind_one_that_a_full_link_holds_up_arrives_soon_all_the_same(lab: Lab) -> None:
    lab.describe_section_v({"a": 0.9})
    lab.router()
    lab.agent("a", realtime=1.0)
    fleet = lab.orchestrator("a")
    goal = GoalRequest(goal_id="g", owner=fleet.orchestrator_id, motion=LONG)
    plan = submitted(fleet, "a", goal).plan
    sent, ended = 0, threading.Event()

    def fill() -> None:
        nonlocal sent
        with open_client(lab.endpoint, timeout_s=PATIENCE_S) as filling:
            while not ended.is_set():
                filling._session.put(
                    KEYS.robot("b", "state"),
                    bytes(60_000),
                    priority=zenoh.Priority.REAL_TIME,
                    congestion_control=zenoh.CongestionControl.BLOCK,
                )
                sent += 1

    filler = threading.Thread(target=fill)
    with open_client(lab.endpoint, timeout_s=PATIENCE_S) as stopping:
        with frozen_reader(lab.endpoint, fleet):
            filler.start()
            try:
                before = -1
                # Until nothing more gets through, or the router has given up the link for that.
                while fleet.watch("b").alive and (before != sent or sent == 0):
                    before = sent
                    time.sleep(0.05)
                heard = lab.wait_for_state(fleet, "a", lambda state: state.progress > 0)
                # The router serves them in this order.
                stopping.put_urgent(KEYS.command("b", "me", "stop"), STOP)
                stopping.put_urgent(KEYS.command("a", "me", "stop"), STOP)
                lab.wait_for_state(fleet, "a", lambda state: state.last_goal_id == "g")
            finally:
                ended.set()
        filler.join(PATIENCE_S)
    # In its own time, which passes as slowly as a busy machine lets it.
    played_s = len(fleet.result("a", "g").response) * plan.sample_time_s
    assert played_s - heard.progress * plan.duration_s < 3.0
