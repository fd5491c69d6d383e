"""Decides from what ROS 2 shows of topics and services whether a robot can be moved through them.

Pure functions; each returns a sentence for people, or None if all is well.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

SERVICE_TYPES = ("std_srvs/srv/Trigger", "std_srvs/srv/SetBool")


@dataclass(frozen=True)
class Endpoint:
    """A publisher or a subscription of another node."""

    node: str
    """Full name of the node."""
    type: str
    """Type of the messages."""
    reliability: Literal["reliable", "best_effort"]
    """Offered by a publisher, or asked by a subscription."""


def reading_problem(
    topic: str,
    kind: str,
    publishers: Sequence[Endpoint],
    *,
    reliability: str,
    alone: bool = True,
    topics: Mapping[str, Sequence[str]],
) -> str | None:
    """Return why a topic cannot be read.

    Args:
        topic: Full name of the topic.
        kind: Type that the fleet file states.
        publishers: Publishers of the topic.
        reliability: Reliability that the fleet file asks for.
        alone: Whether there must be one publisher only.
        topics: Types of all topics, by name.
    """
    if not publishers:
        return f"no node publishes {topic}{_elsewhere(kind, topics)}"
    problem = _type_problem(topic, kind, publishers)
    if problem is not None:
        return problem
    if alone and len(publishers) > 1:
        return (
            f"{topic} is published by {len(publishers)} nodes ({_nodes(publishers)}): two robots "
            "share a namespace"
        )
    if reliability == "reliable" and any(one.reliability != "reliable" for one in publishers):
        return (
            f"{_nodes(publishers)} publishes {topic} best_effort, and the fleet file asks for "
            'reliable, so nothing would arrive: state qos.reliability = "best_effort"'
        )
    return None


def writing_problem(
    topic: str,
    kind: str,
    subscriptions: Sequence[Endpoint],
    rivals: Sequence[Endpoint],
    *,
    reliability: str,
    topics: Mapping[str, Sequence[str]],
) -> str | None:
    """Return why set-points cannot be sent.

    Args:
        topic: Full name of the topic.
        kind: Type that the fleet file states.
        subscriptions: Nodes that listen.
        rivals: Other nodes that publish there.
        reliability: Reliability that the fleet file offers.
        topics: Types of all topics, by name.
    """
    problem = _type_problem(topic, kind, [*subscriptions, *rivals])
    if problem is not None:
        return problem
    if rivals:
        return (
            f"another program sends set-points on {topic} ({_nodes(rivals)}): end it, or give the "
            "two robots namespaces of their own; one that was killed is forgotten after 20 s"
        )
    if not subscriptions:
        return f"no node listens on {topic}{_elsewhere(kind, topics)}"
    if reliability == "best_effort" and any(one.reliability == "reliable" for one in subscriptions):
        return (
            f"{_nodes(subscriptions)} asks for reliable set-points on {topic}, and the fleet file "
            'offers best_effort, so nothing would arrive: state qos.reliability = "reliable"'
        )
    return None


def service_problem(
    name: str, services: Mapping[str, Sequence[str]], *, both_ways: bool = False
) -> str | None:
    """Return why a service cannot be called.

    Args:
        name: Full name of the service.
        services: Types of all services, by name.
        both_ways: Whether it has to arm and to disarm.
    """
    if name not in services:
        like = [
            other
            for other, types in sorted(services.items())
            if any(one in SERVICE_TYPES for one in types)
        ]
        return f"there is no service {name}; there are {_listed(like)}"
    if not any(one in SERVICE_TYPES for one in services[name]):
        return (
            f"the service {name} is of type {_listed(services[name])}; only "
            f"{' and '.join(SERVICE_TYPES)} can be called"
        )
    if both_ways and SERVICE_TYPES[1] not in services[name]:
        return (
            f"the service {name} is of type {SERVICE_TYPES[0]}, which arms and cannot disarm: name "
            "the service that does as services.disarm"
        )
    return None


def _type_problem(topic: str, kind: str, endpoints: Sequence[Endpoint]) -> str | None:
    for one in endpoints:
        if one.type != kind:
            return f"{topic} is of type {one.type} at {one.node}, and the fleet file says {kind}"
    return None


def _elsewhere(kind: str, topics: Mapping[str, Sequence[str]]) -> str:
    like = [name for name, types in sorted(topics.items()) if kind in types]
    return f"; topics of type {kind}: {_listed(like)}"


def _nodes(endpoints: Sequence[Endpoint]) -> str:
    return _listed(sorted(one.node for one in endpoints))


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names) or "none"
