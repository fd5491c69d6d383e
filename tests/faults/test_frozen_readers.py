"""A robot's computer that hangs while its link is full holds up no other robot's stop."""

from __future__ import annotations

import threading
import time

import zenoh

from benchmarks.faults.lab import KEYS, Lab
from benchmarks.faults.logbook import TOLD_TO_REST
from benchmarks.faults.program import PATIENCE_S, wait_until
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.frame import stop_frame
from nufleet.shared.wire.messages import GoalRequest
from nufleet.shared.wire.transport import open_client

LONG = Excitation(axis="x", tones=(Tone(omega_rad_s=1.0),), settle_s=60.0)
STOP = stop_frame("somebody", "smoke")


def told_s(lab: Lab, robot: str) -> list[float]:
    return [entry.time_s for entry in lab.logbook(robot) if entry.what == TOLD_TO_REST]


def test_a_stop_behind_one_that_a_full_link_holds_up_arrives_soon_all_the_same(lab: Lab) -> None:
    lab.describe_section_v(dict.fromkeys("ab", 0.9))
    lab.router()
    frozen = lab.agent("b", realtime=1.0)
    lab.agent("a", realtime=1.0)
    fleet = lab.orchestrator("a", "b")
    fleet.submit("a", GoalRequest(goal_id="g", owner=fleet.orchestrator_id, motion=LONG))
    lab.wait_for_state(fleet, "a", lambda state: state.progress > 0)
    sent = 0
    ended = threading.Event()

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

    with open_client(lab.endpoint, timeout_s=PATIENCE_S) as stopping:
        frozen.freeze()
        filler = threading.Thread(target=fill)
        filler.start()
        try:
            before = -1
            while before != sent or sent == 0:  # until nothing more gets through
                before = sent
                time.sleep(0.05)
            began_s = time.monotonic()
            # The router serves them in this order.
            stopping.put_urgent(KEYS.command("b", "me", "stop"), STOP)
            stopping.put_urgent(KEYS.command("a", "me", "stop"), STOP)
            wait_until(lambda: bool(told_s(lab, "a")))
        finally:
            ended.set()
            frozen.thaw()
            filler.join(PATIENCE_S)
    assert told_s(lab, "a")[0] - began_s < 1.5
