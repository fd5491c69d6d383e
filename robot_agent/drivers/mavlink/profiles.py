"""What PX4 and ArduPilot call the same things: modes, their numbers, and how one takes off."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

PX4_MAIN = {
    1: "manual",
    2: "altitude",
    3: "position",
    5: "acro",
    6: "offboard",
    7: "stabilized",
    8: "rattitude",
    10: "termination",
}
PX4_AUTO = {
    1: "ready",
    2: "take-off",
    3: "hold",
    4: "mission",
    5: "return",
    6: "land",
    8: "follow-target",
    9: "precision-land",
}
"""PX4's modes: the main mode and, in main mode 4 (auto), the sub-mode."""

PX4_MODES = {main << 16: name for main, name in PX4_MAIN.items()} | {
    4 << 16 | sub << 24: name for sub, name in PX4_AUTO.items()
}

COPTER_MODES = {
    0: "stabilize",
    1: "acro",
    2: "altitude-hold",
    3: "auto",
    4: "guided",
    5: "loiter",
    6: "return",
    7: "circle",
    9: "land",
    11: "drift",
    13: "sport",
    14: "flip",
    15: "autotune",
    16: "position-hold",
    17: "brake",
    18: "throw",
    19: "avoid-adsb",
    20: "guided-without-gps",
    21: "smart-return",
    22: "flow-hold",
    23: "follow",
    24: "zigzag",
    25: "system-identification",
    26: "autorotate",
    27: "auto-return",
    28: "turtle",
}
"""Modes of ArduPilot's Copter."""

PILOTS = frozenset(
    {
        "manual",
        "altitude",
        "position",
        "acro",
        "stabilized",
        "rattitude",
        "stabilize",
        "altitude-hold",
        "loiter",
        "drift",
        "sport",
        "flip",
        "autotune",
        "position-hold",
        "throw",
        "flow-hold",
        "zigzag",
        "turtle",
    }
)
"""Modes in which a pilot flies by sticks."""

PX4_AUTOPILOT, ARDUPILOT_AUTOPILOT = 12, 3
"""Numbers of MAV_AUTOPILOT in their heartbeats."""


@dataclass(frozen=True)
class Profile:
    """One autopilot."""

    name: str
    """Its name, for people."""
    autopilot: int
    """Its number in heartbeats."""
    modes: Mapping[int, str]
    """Names of its modes, by the `custom_mode` of heartbeats."""
    obeys: str
    """Mode in which it follows our set-points."""
    stream_s: float
    """Time for which set-points have to stream before it enters that mode."""
    climbs_itself: bool
    """Whether it takes off by MAV_CMD_NAV_TAKEOFF in that mode rather than by set-points."""
    id_parameter: str
    """Parameter that holds its system id."""
    counts_heartbeats: bool
    """Whether it tells by our heartbeats, rather than by set-points, that we are there."""

    def mode_parameters(self, mode: str) -> tuple[float, float, float]:
        """Return the first parameters of MAV_CMD_DO_SET_MODE for a mode."""
        number = next(number for number, name in self.modes.items() if name == mode)
        if self.autopilot == PX4_AUTOPILOT:
            return (1.0, float(number >> 16 & 0xFF), float(number >> 24 & 0xFF))
        return (1.0, float(number), 0.0)

    def mode_name(self, custom_mode: int) -> str:
        """Return the name of the mode that a heartbeat tells."""
        return self.modes.get(custom_mode, f"mode {custom_mode:#x}")

    def left_for(self, mode: str) -> str:
        """Return what it means that the vehicle left our mode for another one."""
        if mode in PILOTS:
            return f"a pilot took over ({mode} mode)"
        return (
            f"the vehicle left {self.obeys} mode for {mode} mode, by a failsafe of its own or a "
            "ground station"
        )


PX4 = Profile("PX4", PX4_AUTOPILOT, PX4_MODES, "offboard", 1.2, False, "MAV_SYS_ID", False)
ARDUPILOT = Profile(
    "ArduPilot", ARDUPILOT_AUTOPILOT, COPTER_MODES, "guided", 0.0, True, "SYSID_THISMAV", True
)
PROFILES = {"px4": PX4, "ardupilot": ARDUPILOT}
"""The profiles, by their names in fleet files."""

RESULTS = {
    1: "it refuses for now",
    2: "it denies it",
    3: "it does not know this command",
    4: "it failed",
    6: "it was cancelled",
}
"""Results of MAV_RESULT other than accepted (0) and in progress (5), in words."""

ESTIMATOR_ATTITUDE, ESTIMATOR_POSITION, ESTIMATOR_GUESSES = 1, 8 | 16, 128
"""Bits of ESTIMATOR_STATUS and EKF_STATUS_REPORT: attitude; horizontal position, relative or
absolute; and position kept constant because none is measured."""
