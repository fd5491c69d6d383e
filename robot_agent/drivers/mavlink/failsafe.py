"""Whether ArduPilot notices that this computer has fallen silent, by its parameters.

Its failsafe for ground stations counts the heartbeats of a single system. If that is not the
driver, or the failsafe is off, a vehicle in guided mode hovers on when the driver dies, until its
battery is low. PX4 watches the set-points themselves and needs no such check.
"""

from __future__ import annotations

from collections.abc import Mapping

WATCHED = ("SYSID_MYGCS", "MAV_GCS_SYSID")
"""Names of the parameter with the system that is watched: up to Copter 4.6, and from 4.7."""

ACTION = "FS_GCS_ENABLE"
"""Parameter with what the vehicle does when that system falls silent; 0 for nothing."""

NEEDED = (*WATCHED, ACTION)


def known(parameters: Mapping[str, float]) -> bool:
    """Return whether the parameters that matter have arrived."""
    return ACTION in parameters and any(name in parameters for name in WATCHED)


def unwatched(parameters: Mapping[str, float], own_system_id: int) -> str:
    """Return why the vehicle would not notice that the driver is gone; nothing if it would.

    Args:
        parameters: Values of the parameters that arrived, by name.
        own_system_id: System id under which the driver sends.
    """
    if not known(parameters):
        return (
            f"the vehicle does not tell {' or '.join(WATCHED)}, and {ACTION}, so that it is not "
            "known whether it lands when this computer falls silent: check that the link carries "
            "PARAM_VALUE"
        )
    name = next(name for name in WATCHED if name in parameters)
    if parameters[name] != own_system_id:
        return (
            f"the vehicle watches system {parameters[name]:g} and would not notice that this "
            f"computer falls silent: set {name} = {own_system_id}, the driver's own_system_id"
        )
    if not parameters[ACTION]:
        return (
            "the vehicle does nothing when this computer falls silent: set "
            f"{ACTION} = 5, so that it lands"
        )
    return ""
