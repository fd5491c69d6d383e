"""The firmware of a simulated Crazyflie: its protocol, supervisor and commanders.

It answers what cflib asks with version 12 of the protocol (CRTP), and keeps the rules of Bitcraze's
firmware that a driver lives with: set-points outrank the high-level commander until they are given
up, and a drone that hears none for 0.5 s levels out and for 2 s switches off and locks.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from nufleet.shared.arrays import FloatArray
from nufleet.sims.crazyflies.plant import Plant, drift, fall
from nufleet.sims.crazyflies.tables import (
    LOG_CODES,
    LOG_FORMATS,
    LOGGED,
    PARAMETER_CODES,
    PARAMETER_FORMATS,
    PARAMETERS,
    Table,
)

PARAM, MEM, LOG, LOCALIZATION, SETPOINT, HIGH_LEVEL = 2, 4, 5, 6, 7, 8
SUPERVISOR, PLATFORM, LINK = 9, 13, 15
"""Ports of the protocol."""

PROTOCOL = 12
TICK_S = 0.01
LEVEL_OUT_S, SWITCH_OFF_S, WATCHDOG_S = 0.5, 2.0, 1.0

ARMABLE, ARMED, CAN_FLY, FLYING, LOCKED = 1, 2, 8, 16, 64
"""Bits of `supervisor.info`."""

UNSETTLED_M2 = 100.0
"""Variance of a position after the estimator was reset."""


@dataclass
class Block:
    """A log block that cflib has asked for."""

    variables: list[tuple[int, int]]
    """Type and number of each variable."""
    period_s: float = 0.0
    """Time between two of its packets; 0 while it is stopped."""
    due_s: float = 0.0
    """When the next one is due."""


@dataclass
class Climb:
    """A trajectory of the high-level commander, straight and smooth."""

    start_m: FloatArray
    """Position at its beginning in m, shape (3,)."""
    end_m: FloatArray
    """Position at its end in m, shape (3,)."""
    began_s: float
    """Time at which it began, in s."""
    lasts_s: float
    """Its duration in s."""

    def at(self, now_s: float) -> FloatArray:
        """Return the set-point at a time, shape (3,)."""
        s = min(1.0, max(0.0, (now_s - self.began_s) / self.lasts_s))
        point: FloatArray = self.start_m + (self.end_m - self.start_m) * s**3 * (
            10 - 15 * s + 6 * s**2
        )
        return point


@dataclass
class Ailments:
    """What is wrong with a drone, to be changed while it flies."""

    battery_v: float = 4.0
    """Voltage of its battery."""
    lost: bool = False
    """Whether the position estimate is lost."""
    needs_poses: bool = False
    """Whether it is valid only while positions are sent."""
    stamp_ms: Callable[[int], int] = field(default=lambda stamp_ms: stamp_ms)
    """Fault in the log's time stamps."""


class Firmware:
    """One drone; time is given by the caller, in s, and never goes back."""

    def __init__(
        self, plant: Plant, rng: np.random.Generator, *, now_s: float, noise_m: float = 0.0
    ) -> None:
        """Switch it on.

        Args:
            plant: What flies.
            rng: Generator of the noise of its position estimate.
            now_s: Present time in s.
            noise_m: Standard deviation of that noise.
        """
        self.plant, self.ailments = plant, Ailments()
        self._rng, self._noise_m = rng, noise_m
        self._switched_on_s = self._now_s = now_s
        self._tick_s = now_s
        self._blocks: dict[int, Block] = {}
        self.parameters = dict.fromkeys(PARAMETERS, 0.0)
        """Values of the parameters by name."""
        self.poses: list[tuple[float, ...]] = []
        """Positions that it was told."""
        self.setpoints = 0
        """Number of set-points that have arrived."""
        self.armed = self.locked = self.thrusting = False
        self._reset_s = self._told_s = now_s
        self._heard_s: float | None = None  # the last set-point, while set-points are valid
        self._watched_s: float | None = None
        self._target = (plant.position_m.copy(), np.zeros(3))
        self._climb: Climb | None = None
        self._tables = {LOG: Table(LOGGED, LOG_CODES), PARAM: Table(PARAMETERS, PARAMETER_CODES)}

    def advance(self, now_s: float) -> list[tuple[float, bytes]]:
        """Fly until a time; return the packets that it has sent by then, with their times."""
        packets: list[tuple[float, bytes]] = []
        while self._tick_s + TICK_S <= now_s:
            self._tick_s += TICK_S
            self._fly_until(self._tick_s)
            self._supervise()
            packets += ((self._tick_s, packet) for packet in self._logged())
        self._fly_until(now_s)
        return packets

    def take(self, packet: bytes, now_s: float) -> list[tuple[float, bytes]]:
        """Take a packet that arrives now; return the answer, after what was sent before."""
        before = self.advance(now_s)
        port, channel, data = packet[0] >> 4, packet[0] & 3, packet[1:]
        answer = self._answer(port, channel, data) if data else None
        return before if answer is None else [*before, (now_s, packet[:1] + answer)]

    @property
    def info(self) -> int:
        """What the supervisor says."""
        flying = self.thrusting and self.plant.position_m[2] > 0.05
        return (
            (ARMABLE if not self.locked else LOCKED)
            | (ARMED * self.armed)
            | (CAN_FLY * (self.armed and not self.locked))
            | (FLYING * flying)
        )

    def _fly_until(self, now_s: float) -> None:
        lasts_s, self._now_s = now_s - self._now_s, max(now_s, self._now_s)
        if lasts_s <= 0:
            return
        if not self.thrusting:
            fall(self.plant, lasts_s)
        elif self._heard_s is not None and now_s - self._heard_s > LEVEL_OUT_S:
            drift(self.plant, lasts_s)
        else:
            self.plant.follow(*self._target, lasts_s)
        if self._climb is not None:
            self._target = (self._climb.at(now_s), np.zeros(3))

    def _supervise(self) -> None:
        silent = self._heard_s is not None and self._now_s - self._heard_s > SWITCH_OFF_S
        unfed = self._watched_s is not None and self._now_s - self._watched_s > WATCHDOG_S
        if (silent and self.thrusting) or unfed:
            self._stop(locked=True)

    def _stop(self, *, locked: bool) -> None:
        self.thrusting = False
        self._heard_s = self._climb = None
        if locked:
            self.locked, self.armed = True, False

    def _answer(self, port: int, channel: int, data: bytes) -> bytes | None:
        """Obey a packet; return the answer to it, None if it has none."""
        handlers: dict[tuple[int, int], Callable[[bytes], bytes | None]] = {
            (LINK, 1): lambda _: b"Bitcraze Crazyflie",
            (LINK, 0): lambda data: data,
            (PLATFORM, 1): lambda _: bytes([0, PROTOCOL]),
            (MEM, 0): lambda data: bytes([data[0], 0]),
            (LOG, 0): self._tables[LOG].answer,
            (PARAM, 0): self._tables[PARAM].answer,
            (PARAM, 1): self._read_parameter,
            (PARAM, 2): self._set_parameter,
            (LOG, 1): self._set_up_log,
            (SUPERVISOR, 0): lambda data: bytes([data[0] | 0x80]) + struct.pack("<H", self.info),
            (SUPERVISOR, 1): self._obey_supervisor,
            (LOCALIZATION, 0): lambda data: self._take_pose(struct.unpack("<fff", data)),
            (LOCALIZATION, 1): lambda data: self._take_pose(struct.unpack("<fffffff", data[1:])),
            (SETPOINT, 0): self._take_setpoint,
            (SETPOINT, 1): self._give_up_setpoints,
            (HIGH_LEVEL, 0): self._take_high_level,
        }
        handler = handlers.get((port, channel))
        return None if handler is None else handler(data)

    def _take_pose(self, pose: tuple[float, ...]) -> None:
        self.poses.append(pose)
        self._told_s = self._now_s

    def _give_up_setpoints(self, _: bytes) -> None:
        self._heard_s = None

    def _read_parameter(self, data: bytes) -> bytes:
        return data[:2] + b"\0" + self._packed(*struct.unpack("<H", data[:2]))

    def _packed(self, place: int) -> bytes:
        name = self._tables[PARAM].names[place]
        value, kind = self.parameters[name], PARAMETERS[name]
        return struct.pack(PARAMETER_FORMATS[kind], value if kind == "float" else int(value))

    def _set_parameter(self, data: bytes) -> bytes:
        (place,) = struct.unpack("<H", data[:2])
        name = self._tables[PARAM].names[place]
        (value,) = struct.unpack(PARAMETER_FORMATS[PARAMETERS[name]], data[2:])
        self.parameters[name] = float(value)
        if name == "kalman.resetEstimation" and value:
            self._reset_s = self._now_s
        return data

    def _set_up_log(self, data: bytes) -> bytes:
        command, number = data[0], data[1] if len(data) > 1 else 0
        if command in (6, 7):
            variables = [struct.unpack_from("<BH", data, k) for k in range(2, len(data) - 2, 3)]
            kept = [] if command == 6 else self._blocks[number].variables
            self._blocks[number] = Block([*kept, *((kind & 15, own) for kind, own in variables)])
        elif command == 3:
            self._blocks[number].period_s = TICK_S * data[2]
            self._blocks[number].due_s = self._now_s
        elif command == 4 and number in self._blocks:
            self._blocks[number].period_s = 0.0
        elif command == 2:
            self._blocks.pop(number, None)
        elif command == 5:
            self._blocks.clear()
        return bytes([command, number, 0])

    def _obey_supervisor(self, data: bytes) -> bytes | None:
        match data[0]:
            case 1:
                self.armed = bool(data[1]) and not self.locked
                return bytes([0x81, 1, self.armed])
            case 3:
                self._stop(locked=True)
            case 4:
                self._watched_s = self._now_s
        return None

    def _take_setpoint(self, data: bytes) -> None:
        if not self.armed:
            return
        self.setpoints += 1
        if data[0] == 7:
            where = np.array(struct.unpack("<fff", data[1:13]))
            self._target = (where, np.zeros(3))
        elif data[0] == 6:
            numbers = np.array(struct.unpack("<hhhhhh", data[1:13])) / 1000
            self._target = (numbers[:3], numbers[3:])
        else:
            self._stop(locked=False)
            return
        self._heard_s, self._climb, self.thrusting = self._now_s, None, True

    def _take_high_level(self, data: bytes) -> None:
        if data[0] == 3:
            self._stop(locked=False)
        elif data[0] in (7, 8) and self.armed and self._heard_s is None:
            height_m, _, _, lasts_s = struct.unpack("<ff?f", data[2:15])
            end_m = self.plant.position_m.copy()
            end_m[2] = height_m
            self._climb = Climb(self.plant.position_m.copy(), end_m, self._now_s, lasts_s)
            self._target = (self.plant.position_m.copy(), np.zeros(3))
            self.thrusting = True

    def _logged(self) -> list[bytes]:
        packets = []
        for number, block in self._blocks.items():
            if not block.period_s or self._tick_s < block.due_s:
                continue
            block.due_s += block.period_s * max(
                1, np.ceil((self._tick_s - block.due_s) / block.period_s)
            )
            stamp_ms = round(1000 * (self._tick_s - self._switched_on_s))
            stamp = (self.ailments.stamp_ms(stamp_ms) % (1 << 24)).to_bytes(3, "little")
            values = self._values()
            names = self._tables[LOG].names
            data = b"".join(
                struct.pack(LOG_FORMATS[kind], values[names[place]])
                for kind, place in block.variables
            )
            packets.append(bytes([LOG << 4 | 2, number]) + stamp + data)
        return packets

    def _values(self) -> dict[str, float]:
        seen_m = self.plant.position_m + self._noise_m * self._rng.standard_normal(3)
        attitude = compressed(self.plant.quaternion.tolist())
        states = (*seen_m, *self.plant.velocity_m_s, attitude)
        variance = self._variance_m2()
        info = self.info
        return dict(
            zip(LOGGED, (*states, self.ailments.battery_v, info, *[variance] * 3), strict=True)
        )

    def _variance_m2(self) -> float:
        since_s = self._now_s - self._reset_s
        told = not self.ailments.needs_poses or self._now_s - self._told_s < LEVEL_OUT_S
        if self.ailments.lost or not told:
            return UNSETTLED_M2 + since_s
        return float(1e-4 + UNSETTLED_M2 * np.exp(-since_s / 0.02))


def compressed(quaternion: list[float]) -> int:
    """Return a unit quaternion x, y, z, w in 32 bits, as the firmware's `quatcompress.h` does."""
    largest = int(np.argmax(np.abs(quaternion)))
    packed = largest
    for k, part in enumerate(quaternion):
        if k != largest:
            negative = (part < 0) != (quaternion[largest] < 0)
            packed = packed << 10 | negative << 9 | int(511 * abs(part) * np.sqrt(2) + 0.5)
    return packed
