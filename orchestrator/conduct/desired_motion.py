"""The trajectory that a ranking is for: a drawing, flown at some speed by the target."""

from __future__ import annotations

from dataclasses import dataclass

from nufleet.orchestrator.study.interface import DesiredMotion
from nufleet.orchestrator.study.trajectory_spectrum import spectrum_of
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.installed import find_drawing
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.robots.spec import RobotSpec


@dataclass(frozen=True, eq=False)
class TimedPath:
    """A drawing that was asked for: its points in m, shape (n, 2), and its largest speed.

    Without a speed the target chooses: what its axis allows.
    """

    name: str
    points: FloatArray
    speed_m_s: float | None


def read_motion(path_or_name: str, speed_m_s: float | None) -> TimedPath:
    """Read a drawing given as a path or by the name it is installed under.

    Raises:
        InvalidInputError: there is none, or it is not a path that can be flown.
    """
    path = find_drawing(path_or_name)
    return TimedPath(path.stem, read_drawing(path), speed_m_s)


def desired_motion(drawing: TimedPath, spec: RobotSpec, axis: str) -> DesiredMotion:
    """Return how a drawing's motion is distributed over frequency when the target flies it.

    Both axes of the drawing are added up: their responses are taken to be alike, as in the paper.

    Args:
        drawing: what was asked for.
        spec: the target's.
        axis: the axis that is tested.

    Raises:
        InvalidInputError: the axis does not move in m, or the drawing cannot be flown.
    """
    limits = spec.axis(axis)
    if limits.unit != "m":
        raise InvalidInputError(
            f"a drawing is in m, and axis {axis} of the target moves in {limits.unit}: "
            "leave --trajectory out"
        )
    speed_m_s = limits.velocity_max if drawing.speed_m_s is None else drawing.speed_m_s
    positions = travel(drawing.points, speed_m_s, limits.acceleration_max, spec.sample_time_s)
    spectrum = spectrum_of(positions, spec.sample_time_s)
    return DesiredMotion(
        name=f"{drawing.name} at {speed_m_s:g} m/s",
        omega_rad_s=tuple(spectrum.omega_rad_s.tolist()),
        power=tuple(spectrum.power.tolist()),
    )
