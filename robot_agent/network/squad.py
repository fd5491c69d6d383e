"""What the robots of one session do together: tell their states, and hear the stops of the fleet.

A robot of its own session is alone in its squad. Hundreds of simulated robots share one: with a
subscription and a thread for each of them, a stop of the whole fleet would take Python's
interpreter once per robot, and reach the last one seconds after the first while all are moving.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager

from nufleet.robot_agent.network.endpoint import MAX_REQUEST_BYTES
from nufleet.robot_agent.network.heartbeat import Heartbeat
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.session import Session

Halted = Callable[[str, bytes], Callable[[], None]]
"""Function that takes the key and the payload of a stop, halts a robot, and returns what is left to
do when all are halted."""

CLERKS = 4
"""Number of threads that write for all robots of a squad; the disk writes for several at a time."""

_log = logging.getLogger(__name__)


class Squad:
    """The robots of one session; a context manager, which all of them have left before it ends."""

    def __init__(self, session: Session, keys: FleetKeys) -> None:
        """Begin without robots.

        Args:
            session: Session of the robots.
            keys: Keys of their fleet.
        """
        self._halted: dict[str, Halted] = {}
        self._open = ExitStack()
        with ExitStack() as opened:
            self.writer = opened.enter_context(ThreadPoolExecutor(1, thread_name_prefix="stops"))
            """Stores the stops of the robots, one after the other."""
            self.clerks = opened.enter_context(
                ThreadPoolExecutor(CLERKS, thread_name_prefix="clerk")
            )
            """Write what else the robots keep on the disk, and what no motion waits for."""
            # A thread that begins waits for the interpreter, and no stop should wait for that.
            self.writer.submit(int).result()
            self.heartbeat = Heartbeat(session, keys)
            """Publishes the states of the robots."""
            opened.callback(self.heartbeat.close)
            for key in keys.every_stop:
                stop = session.subscribe(key, self._on_stop, max_bytes=MAX_REQUEST_BYTES)
                opened.callback(stop.withdraw)
            self._open = opened.pop_all()

    def __enter__(self) -> Squad:
        return self

    def __exit__(self, *_: object) -> None:
        self._open.close()

    def hear_stops(self, robot: str, halted: Halted) -> Callable[[], None]:
        """Halt a robot at each stop of the whole fleet, on Zenoh's thread.

        Args:
            robot: Name of the robot.
            halted: Function that halts it.

        Returns:
            Function that ends this.
        """
        self._halted[robot] = halted

        def leave() -> None:
            del self._halted[robot]

        return leave

    def _on_stop(self, key: str, payload: bytes) -> None:
        # All robots are halted before the first one's motors are cut and its stop is stored.
        rests: dict[str, Callable[[], None]] = {}
        for robot, halted in self._halted.copy().items():
            with _for_itself(robot):
                rests[robot] = halted(key, payload)
        for robot, rest in rests.items():
            with _for_itself(robot):
                rest()


@contextmanager
def _for_itself(robot: str) -> Iterator[None]:
    """Log what goes wrong with one robot; the others are to be stopped all the same."""
    try:
        yield
    except Exception:  # noqa: BLE001 - see above
        _log.exception("%s could not be stopped", robot)
