"""Find out which robot's experience will help, before you transfer it.

These names are for programs outside of this project; everything else may change without notice.

>>> import nufleet
>>> x = nufleet.AxisSpec(
...     name="x", unit="m", amplitude_max=0.3, velocity_max=1.0, acceleration_max=2.0
... )
>>> cart = nufleet.RobotSpec(
...     kind="cart",
...     axes=(x,),
...     sample_time_s=0.01,
...     omega_min_rad_s=0.5,
...     omega_max_rad_s=20.0,
...     duration_max_s=120.0,
...     settling_time_s=2.0,
...     simulated=True,
... )
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from nufleet.orchestrator.scripting import load_run, rank, track, transfer
    from nufleet.robot_agent.robot import Record, Robot
    from nufleet.shared.errors import NufleetError, RobotDownError, RobotError
    from nufleet.shared.robots.drivers import RobotDriver, SeparateRobots
    from nufleet.shared.robots.health import Health
    from nufleet.shared.robots.spec import AxisSpec, RobotSpec, TrackingLimits
    from nufleet.shared.strict import Strict as Settings

__all__ = [
    "AxisSpec",
    "Health",
    "NufleetError",
    "Record",
    "Robot",
    "RobotDownError",
    "RobotDriver",
    "RobotError",
    "RobotSpec",
    "SeparateRobots",
    "Settings",
    "TrackingLimits",
    "load_run",
    "rank",
    "track",
    "transfer",
]

_PLACES = {
    "AxisSpec": "nufleet.shared.robots.spec",
    "Health": "nufleet.shared.robots.health",
    "NufleetError": "nufleet.shared.errors",
    "Record": "nufleet.robot_agent.robot",
    "Robot": "nufleet.robot_agent.robot",
    "RobotDownError": "nufleet.shared.errors",
    "RobotDriver": "nufleet.shared.robots.drivers",
    "RobotError": "nufleet.shared.errors",
    "RobotSpec": "nufleet.shared.robots.spec",
    "SeparateRobots": "nufleet.shared.robots.drivers",
    "Settings": "nufleet.shared.strict",
    "TrackingLimits": "nufleet.shared.robots.spec",
    "load_run": "nufleet.orchestrator.scripting",
    "rank": "nufleet.orchestrator.scripting",
    "track": "nufleet.orchestrator.scripting",
    "transfer": "nufleet.orchestrator.scripting",
}


def __getattr__(name: str) -> Any:
    """Import a public name when it is first used, so that the command line starts quickly."""
    if name not in _PLACES:
        raise AttributeError(f"module 'nufleet' has no attribute {name!r}")
    return getattr(import_module(_PLACES[name]), {"Settings": "Strict"}.get(name, name))
