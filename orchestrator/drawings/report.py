"""A report on a drawing: its shape, how long it takes, and which robots may fly it."""

from __future__ import annotations

from collections.abc import Sequence

from rich.table import Column, Table

from nufleet.orchestrator.flights.legs import trajectory
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.paths.shape import DrawingShape, shape_of
from nufleet.shared.paths.trajectories import travel
from nufleet.shared.strict import Document, Positive, Strict
from nufleet.shared.wire.messages import Description

SPEEDS = (0.3, 0.6, 0.9)
"""Largest speeds in m/s of the paper's trajectories (Section VI)."""

ACCELERATION_MAX_M_S2 = 1.6
"""Acceleration limit of the simulated quadrotors, assumed when no robot is named."""
SAMPLE_TIME_S = 0.02
"""Sample time of the simulated quadrotors, assumed when no robot is named."""


class Duration(Strict):
    """The time that a drawing takes at one speed, or the reason why a robot may not fly it."""

    robot: str | None
    """Name of the robot; None for the default limits."""
    speed: Positive
    """Largest speed on the path, in the unit of the robot's axes per second."""
    duration_s: Positive | None
    """Duration of the flight; None when the robot may not fly it."""
    reason: str | None = None
    """Why the robot may not fly it; None when it may."""


class DrawingReport(Document):
    """What `nufleet drawing import --json` and `show --json` print."""

    drawing: str
    """Name of the drawing."""
    file: str
    """Path of the drawing's file."""
    shape: DrawingShape
    """Length, extent and curvature of the drawing."""
    durations: tuple[Duration, ...]
    """Duration for each robot and speed."""
    remarks: tuple[str, ...] = ()
    """What these robots leave out of the drawing."""


def report_of(
    drawing: str,
    file: str,
    points: FloatArray,
    robots: Sequence[Description],
    speeds: Sequence[float] = SPEEDS,
) -> DrawingReport:
    """Return the report on a drawing, by the limits of each robot or by the default limits.

    Args:
        drawing: Name of the drawing.
        file: Path of the drawing's file.
        points: Points of the drawing in m, shape (n, 2).
        robots: Descriptions of the robots whose limits count; empty for the default limits.
        speeds: Largest speeds to consider, in m/s.

    Raises:
        InvalidInputError: The points are no path.
    """
    shape = shape_of(points)
    durations = [_duration(points, speed, robot) for robot in robots for speed in speeds]
    if not robots:
        durations = [
            Duration(
                robot=None,
                speed=speed,
                duration_s=SAMPLE_TIME_S
                * len(travel(points, speed, ACCELERATION_MAX_M_S2, SAMPLE_TIME_S)),
            )
            for speed in speeds
        ]
    single = [robot.robot for robot in robots if len(robot.spec.axes) == 1]
    remarks = [f"only the drawing's x is flown by {', '.join(single)}: one axis"] if single else []
    return DrawingReport(
        drawing=drawing,
        file=file,
        shape=shape,
        durations=tuple(durations),
        remarks=tuple(remarks),
    )


def _duration(points: FloatArray, speed: float, robot: Description) -> Duration:
    try:
        path = trajectory(points, speed, robot.spec, robot.robot)
    except InvalidInputError as error:
        return Duration(robot=robot.robot, speed=speed, duration_s=None, reason=str(error))
    return Duration(robot=robot.robot, speed=speed, duration_s=len(path) * robot.spec.sample_time_s)


def shape_text(shape: DrawingShape) -> str:
    """Return the shape of a drawing in one line."""
    bend = (
        "straight"
        if shape.tightest_radius_m is None
        else f"tightest curve of radius {shape.tightest_radius_m:.3f} m"
    )
    return (
        f"{shape.length_m:.2f} m long, {shape.width_m:.2f} m × {shape.height_m:.2f} m, up to "
        f"{shape.furthest_m:.2f} m from the origin, {bend}, {shape.points} points"
    )


def durations_table(report: DrawingReport) -> Table:
    """Return a table of the time that each robot takes at each speed; "no" where it may not fly."""
    speeds = sorted({duration.speed for duration in report.durations})
    numbers = [Column(f"{speed:g} m/s", justify="right") for speed in speeds]
    table = Table("robot", *numbers, title=f"{report.drawing}: duration", title_justify="left")
    for robot in dict.fromkeys(duration.robot for duration in report.durations):
        of = {d.speed: d for d in report.durations if d.robot == robot}
        table.add_row(
            robot or f"any with {ACCELERATION_MAX_M_S2:g} m/s²",
            *(_cell(of[speed]) for speed in speeds),
        )
    return table


def _cell(duration: Duration) -> str:
    return "[red]no[/]" if duration.duration_s is None else f"{duration.duration_s:.1f} s"


def refusals(report: DrawingReport) -> tuple[str, ...]:
    """Return the reasons why robots may not fly a drawing, each once."""
    return tuple(dict.fromkeys(d.reason for d in report.durations if d.reason is not None))
