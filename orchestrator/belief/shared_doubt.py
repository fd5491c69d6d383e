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
    delays_s = {kind: max(one.delay_std_s for one in some) for kind, some in alike.items()}
    settling_s: dict[tuple[str, float], float] = {}
    for robot in robots:
        states = (robot.spec.kind, robot.spec.settling_time_s)
        settling_s[states] = max(settling_s.get(states, 0.0), robot.settling_time_s)
    for robot in robots:
        kind = robot.spec.kind
        robot.doubt_flights(doubt)
        robot.expect_settling(settling_s[kind, robot.spec.settling_time_s])
        robot.doubt_delays(delays_s[kind])
        robot.assume(*shown[kind])
