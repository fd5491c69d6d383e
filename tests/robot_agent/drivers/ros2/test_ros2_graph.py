"""What ROS 2 shows of topics and services becomes a sentence before anything moves."""

from __future__ import annotations

from typing import Any

import pytest

from nufleet.robot_agent.drivers.ros2.graph import (
    Endpoint,
    reading_problem,
    service_problem,
    writing_problem,
)

POSE, ODOMETRY = "geometry_msgs/msg/PoseStamped", "nav_msgs/msg/Odometry"
TOPICS = {"/cf2/odom": [ODOMETRY], "/cf2/pose": [POSE], "/rosout": ["rcl_interfaces/msg/Log"]}


def node(name: str, kind: str, reliability: Any = "reliable") -> Endpoint:
    return Endpoint(name, kind, reliability)


@pytest.mark.parametrize(
    ("publishers", "asked", "said"),
    [
        (
            [],
            "reliable",
            "no node publishes /odom; topics of type nav_msgs/msg/Odometry: /cf2/odom",
        ),
        ([node("/a", POSE)], "reliable", "/odom is of type geometry_msgs/msg/PoseStamped at /a"),
        (
            [node("/b", ODOMETRY), node("/a", ODOMETRY)],
            "best_effort",
            "/odom is published by 2 nodes (/a, /b): two robots share a namespace",
        ),
        (
            [node("/a", ODOMETRY, "best_effort")],
            "reliable",
            'state qos.reliability = "best_effort"',
        ),
    ],
)
def test_why_a_topic_cannot_be_read(publishers: Any, asked: str, said: str) -> None:
    problem = reading_problem("/odom", ODOMETRY, publishers, reliability=asked, topics=TOPICS)
    assert problem is not None
    assert said in problem


def test_a_topic_of_transforms_may_have_several_publishers() -> None:
    both = [node("/a", "tf"), node("/b", "tf")]
    read = {"reliability": "best_effort", "topics": TOPICS}
    assert reading_problem("/tf", "tf", both, alone=False, **read) is None  # type: ignore[arg-type]
    assert reading_problem("/tf", "tf", both[:1], **read) is None  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("listeners", "rivals", "offered", "said"),
    [
        (
            [],
            [],
            "reliable",
            "no node listens on /cmd; topics of type geometry_msgs/msg/PoseStamped",
        ),
        ([node("/a", ODOMETRY)], [], "reliable", "/cmd is of type nav_msgs/msg/Odometry at /a"),
        ([node("/a", POSE)], [node("/b", POSE)], "reliable", "another program sends set-points"),
        ([node("/a", POSE)], [], "best_effort", 'state qos.reliability = "reliable"'),
    ],
)
def test_why_set_points_cannot_be_sent(
    listeners: Any, rivals: Any, offered: str, said: str
) -> None:
    problem = writing_problem("/cmd", POSE, listeners, rivals, reliability=offered, topics=TOPICS)
    assert problem is not None
    assert said in problem


def test_a_robot_that_listens_alone_can_be_sent_set_points() -> None:
    listeners = [node("/a", POSE), node("/recorder", POSE, "best_effort")]
    found = writing_problem("/cmd", POSE, listeners, [], reliability="reliable", topics=TOPICS)
    assert found is None


def test_services_are_known_by_name_and_type() -> None:
    services = {"/cf1/land": ["std_srvs/srv/Trigger"], "/cf1/add": ["example/srv/Add"]}
    assert service_problem("/cf1/land", services) is None
    assert (
        service_problem("/cf1/up", services) == "there is no service /cf1/up; there are /cf1/land"
    )
    wrong = service_problem("/cf1/add", services)
    assert wrong is not None
    assert wrong.startswith("the service /cf1/add is of type example/srv/Add; only std_srvs/srv/")


def test_a_service_that_arms_and_cannot_disarm_needs_one_that_does() -> None:
    services = {"/arm": ["std_srvs/srv/Trigger"], "/both": ["std_srvs/srv/SetBool"]}
    assert service_problem("/both", services, both_ways=True) is None
    problem = service_problem("/arm", services, both_ways=True)
    assert problem is not None
    assert "name the service that does as services.disarm" in problem
