"""What is doubted of some robots of a fleet, extended to the others, which are like them."""

from __future__ import annotations

from collections.abc import Collection

from nufleet.orchestrator.belief.amplitude_dependence import AmplitudeDependence
from nufleet.orchestrator.belief.distortion import of_kind
from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge


def share_doubt(robots: Collection[RobotKnowledge]) -> None:
    """Extend what is doubted of some robots to the others.

    Where the flights of one are no tests, those of the others are not, either; where one of a kind
    settles more slowly than it states, others that state the same may, too; where delays of one
    differ from test to test, they do of others; and what the amplitude does to some of a kind,
    it may do to all of it, as some of a kind that are not linear show what noise may hide in
    the tests of the others.

    Args:
        robots: What is known of every robot of a fleet, at least one.
    """
    doubt = max(robot.flight_doubt for robot in robots)
    kinds = {robot.spec.kind for robot in robots}
    alike = {kind: [robot for robot in robots if robot.spec.kind == kind] for kind in kinds}
    shown = {
        kind: (
            AmplitudeDependence.of_fleet([one.by_amplitude for one in some if one.compared]),
            of_kind([one.distortion for one in some if one.tests]),
        )
        for kind, some in alike.items()
    }
    for robot in robots:
        robot.doubt_flights(doubt)
        stated_s = robot.spec.settling_time_s
        alike_too = [one for one in alike[robot.spec.kind] if one.spec.settling_time_s == stated_s]
        robot.expect_settling(max(one.settling_time_s for one in alike_too))
        robot.doubt_delays(max(one.delay_std_s for one in alike[robot.spec.kind]))
        robot.assume(*shown[robot.spec.kind])
