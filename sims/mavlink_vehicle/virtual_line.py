"""A line to a simulated vehicle on a virtual clock: minutes of flight take a second.

Time passes only while the driver waits. Every packet is packed and parsed as on a real link, and
arrives late, or never, as the link's settings say.
"""

from __future__ import annotations

import heapq
import itertools
import threading
from collections.abc import Callable
from typing import Any, Protocol

import numpy as np
from pymavlink.dialects.v20 import ardupilotmega as dialect

from nufleet.shared.strict import Fraction, NonNegative, Strict
from nufleet.sims.mavlink_vehicle.vehicle import SimulatedVehicle


class LinkSettings(Strict):
    """How packets travel, in either direction."""

    delay_s: NonNegative = 0.002
    """Least time that a packet takes."""
    jitter_s: NonNegative = 0.0
    """Mean of the further time, which is distributed exponentially."""
    loss: Fraction = 0.0
    """Share of the packets that never arrive."""


class _Ear(Protocol):
    def receive(self, message: Any, source: object, arrived_s: float) -> None: ...

    def beat(self, now_s: float) -> float: ...


class VirtualClock:
    """Virtual time, which several lines may share."""

    def __init__(self) -> None:
        self.now_s = 0.0


class VirtualLine:
    """Carries packets between a driver and one vehicle; several threads may use it."""

    def __init__(
        self,
        vehicle: SimulatedVehicle,
        settings: LinkSettings,
        rng: np.random.Generator,
        clock: VirtualClock,
    ) -> None:
        """Lay a line.

        Args:
            vehicle: The vehicle at its far end.
            settings: How packets travel.
            rng: Generator of their delays and losses.
            clock: Virtual time.
        """
        self.vehicle = vehicle
        """The vehicle at its far end."""
        self.silent = False
        """Whether all packets are lost; may be set at any time."""
        self.failure = ""
        """Why nothing is carried any more, as a driver is told; may be set at any time."""
        self.source: object = "vehicle"
        """Address that the vehicle's packets seem to come from."""
        self.at: list[tuple[float, Callable[[], None]]] = []
        """What happens when, in the order of its times; entries are removed as it happens."""
        self._settings, self._rng, self._clock = settings, rng, clock
        self._lock = threading.RLock()
        self._flying: list[tuple[float, int, bool, bytes]] = []
        self._numbers = itertools.count()
        self._ear: _Ear | None = None
        self._beat_s = 0.0
        self._down = dialect.MAVLink(None, srcSystem=vehicle.system_id, srcComponent=1)
        self._up = dialect.MAVLink(None, srcSystem=245, srcComponent=191)
        self._parser = dialect.MAVLink(None)

    def open(self, ear: _Ear) -> None:
        """Begin to carry packets to a driver."""
        self._ear, self._beat_s = ear, self._clock.now_s

    def close(self) -> None:
        """Carry nothing to the driver any more."""
        self._ear = None

    def now_s(self) -> float:
        """Return the virtual time."""
        return self._clock.now_s

    def send(self, message: Any) -> None:
        """Send a driver's message on its way."""
        with self._lock:
            self._send(message, self._up, upwards=True)

    def wait(self, until_s: float, condition: Callable[[], bool] | None = None) -> bool:
        """Let time pass until a time, or until a condition holds; return whether it does."""
        while condition is None or not condition():
            with self._lock:
                if not self._advance(until_s):
                    return False
        return True

    def heard_systems(self) -> tuple[int, ...]:
        """Return the system id of the vehicle, if it sends."""
        return () if self.silent else (self.vehicle.system_id,)

    def _advance(self, until_s: float) -> bool:
        """Have the next thing happen; return False if nothing happens until a time."""
        arrives_s = self._flying[0][0] if self._flying else np.inf
        planned_s = self.at[0][0] if self.at else np.inf
        beat_s = self._beat_s if self._ear is not None else np.inf
        next_s = min(arrives_s, planned_s, beat_s, self.vehicle.next_s)
        if next_s > until_s:
            self._clock.now_s = max(self._clock.now_s, until_s)
            return False
        now_s = self._clock.now_s = max(self._clock.now_s, next_s)
        if planned_s <= now_s:
            self.at.pop(0)[1]()
        elif arrives_s <= now_s:
            self._arrive(now_s)
        elif self._ear is not None and beat_s <= now_s:
            self._beat_s = self._ear.beat(now_s)
        else:
            self._answer(self.vehicle.advance(now_s))
        return True

    def _arrive(self, now_s: float) -> None:
        _, _, upwards, data = heapq.heappop(self._flying)
        for message in self._parser.parse_buffer(data):
            if upwards:
                self._answer(self.vehicle.receive(message, now_s))
            elif self._ear is not None:
                self._ear.receive(message, self.source, now_s)

    def _answer(self, messages: list[Any]) -> None:
        for message in messages:
            self._send(message, self._down, upwards=False)

    def _send(self, message: Any, packer: Any, *, upwards: bool) -> None:
        data = message.pack(packer)
        packer.seq = (packer.seq + 1) % 256
        settings = self._settings
        late_s = settings.delay_s + settings.jitter_s * self._rng.exponential()
        if self._rng.random() >= settings.loss and not self.silent:
            arrives_s = self._clock.now_s + late_s
            heapq.heappush(self._flying, (arrives_s, next(self._numbers), upwards, data))
