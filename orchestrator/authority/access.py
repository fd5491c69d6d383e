"""Who may do what in a closed fleet, as the configuration of its router. Pure.

Zenoh denies what no rule allows, without telling the sender. A rule applies where one of its key
expressions includes that of the message; `**` does not include chunks that begin with `@`, under
which the last states are kept. Rules exist for both directions of each link.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

from nufleet.shared.robots.fleet_file import FleetFile, RouterEntry
from nufleet.shared.wire.keys import ADMITTED, COMMANDS, READS, RELEASE, STOP, FleetKeys
from nufleet.shared.wire.limits import (
    FULL_LINK_WAIT_US,
    LEASE_MS,
    MAX_MESSAGE_BYTES,
    MAX_STATE_BYTES,
)

Rule = dict[str, Any]

STATES_HZ = 500.0
"""Highest rate of each robot's states; the router drops what a stolen robot sends beyond it."""

_HEADER = """\
// Made by `nufleet fleet`: changes made by hand are lost. Start the router with
//   nufleet router --config THIS-FILE
// and restart it after `nufleet fleet enroll` or `revoke` changed this file.
"""


def common_name(principal: str, revocations: int) -> str:
    """Return the name in a principal's certificate.

    Args:
        principal: Name of the principal.
        revocations: Number of times that it was revoked; its certificates of before have other
            names, so that no later one admits them again.
    """
    return f"{principal}.{revocations + 1}"


def router_endpoint(router: RouterEntry, address: str) -> str:
    """Return the endpoint of a router at one of its addresses."""
    return f"tls/[{address}]:{router.port}" if ":" in address else f"tls/{address}:{router.port}"


def router_configuration(
    fleet: FleetFile, router: RouterEntry, revocations: Mapping[str, int]
) -> str:
    """Return the complete configuration of a fleet's router, in JSON5.

    Args:
        fleet: Inventory of the fleet.
        router: Router of the inventory.
        revocations: Number of revocations of each principal; none if absent.
    """
    principals, keys = fleet.principals, FleetKeys(fleet.name)
    people, robots, office = _people(keys), _robots(keys), _office(keys)
    by_role = {"robot": robots, "orchestrator": [*people, *office]}
    own = _own_rules(fleet, keys)
    names = {name: common_name(name, revocations.get(name, 0)) for name in principals}
    shared = {name: by_role.get(role, people) for name, role in principals.items()}
    configuration = {
        "mode": "router",
        # Robots ask for this list, to know whose signatures count.
        "metadata": {"fleet": fleet.name, "robots": [names[name] for name in fleet.robots]},
        "listen": {"endpoints": [router_endpoint(router, router.listen)]},
        "scouting": {"multicast": {"enabled": False}, "gossip": {"enabled": False}},
        "timestamping": {"enabled": True},
        "adminspace": {"enabled": True, "permissions": {"read": True, "write": False}},
        "transport": _transport(len(principals)),
        "access_control": {
            # Without this line everything would be allowed.
            "enabled": True,
            "default_permission": "deny",
            "rules": [
                *people,
                *robots,
                *office,
                *(rule for rules in own.values() for rule in rules),
            ],
            "subjects": [
                {
                    "id": name,
                    "cert_common_names": [names[name]],
                    "link_protocols": ["tls"],
                }
                for name in principals
            ],
            "policies": [
                {
                    "id": name,
                    "subjects": [name],
                    "rules": [rule["id"] for rule in (*shared[name], *own[name])],
                }
                for name in principals
            ],
        },
        "low_pass_filter": [_small_messages(keys)],
        "downsampling": [
            {
                "id": "states",
                "flows": ["ingress"],
                "messages": ["put"],
                "rules": [{"key_expr": keys.every_robot("state"), "freq": STATES_HZ}],
            }
        ],
    }
    return _HEADER + json.dumps(configuration, indent=2) + "\n"


def _transport(principals: int) -> dict[str, Any]:
    waits = {"congestion_control": {"block": {"wait_before_close": FULL_LINK_WAIT_US}}}
    return {
        "shared_memory": {"enabled": False},
        # Each command opens up to two sessions, and several may run under one identity.
        "unicast": {"max_sessions": 64 + 8 * principals, "accept_pending": 100},
        "link": {
            "protocols": ["tls"],
            "tx": {"lease": LEASE_MS, "keep_alive": 4, "queue": waits},
            "rx": {"max_message_size": MAX_MESSAGE_BYTES},
            "tls": {
                "root_ca_certificate": "authority.pem",
                "listen_certificate": "router.pem",
                "listen_private_key": "router.key",
                "enable_mtls": True,
                "close_link_on_expiration": True,
            },
        },
    }


def _own_rules(fleet: FleetFile, keys: FleetKeys) -> dict[str, list[Rule]]:
    """Return the rules of each principal that are about its own name."""
    found = {name: _robot(keys, name) for name in fleet.robots}
    found.update((name, []) for name in fleet.watchers)
    for name in fleet.orchestrators:
        commands = (*COMMANDS, RELEASE)
        alive = f"{keys.root}/orchestrator/{name}.$*/alive"
        found[name] = [
            *_stops(keys, name),
            _commands(keys, name, commands),
            _allow(f"{name}/is-alive", "ingress", ["liveliness_token"], [alive]),
        ]
    for name, operator in fleet.operators.items():
        released = [_commands(keys, name, (RELEASE,))] if operator.may_release else []
        found[name] = [*_stops(keys, name), *released]
    return found


def _people(keys: FleetKeys) -> list[Rule]:
    """Return what orchestrators, operators and watchers have in common: they may watch."""
    every = keys.every_robot
    states = [every("state"), every("state/@adv/**")]
    alive = [every("alive"), every("state/@adv/**"), keys.every_orchestrator_alive]
    return [
        _allow("admitted", "ingress", ["query"], [ADMITTED]),
        _allow("admitted-reply", "egress", ["reply"], [ADMITTED]),
        _allow("watch", "ingress", ["declare_subscriber"], [*states, every("telemetry/*")]),
        _allow(
            "watch-presence",
            "ingress",
            ["declare_liveliness_subscriber", "liveliness_query"],
            alive,
        ),
        _allow("ask", "ingress", ["query"], [*states, *(every(leaf) for leaf in READS)]),
        _allow(
            "hear",
            "egress",
            ["put", "reply", "liveliness_token"],
            [every("**"), every("state/@adv/**"), keys.every_orchestrator_alive],
        ),
        _allow(
            "match",
            "egress",
            ["declare_subscriber", "declare_queryable"],
            [every("**"), every("state/@adv/**"), *keys.every_stop],
        ),
    ]


def _robots(keys: FleetKeys) -> list[Rule]:
    """Return what all robots have in common: they hear stops, and know who commands."""
    every = keys.every_robot
    tokens = ["declare_liveliness_subscriber", "liveliness_query"]
    orchestrators = keys.every_orchestrator_alive
    heard = [*keys.every_stop, orchestrators]
    watched = [every("state"), every("telemetry/*"), every("state/@adv/**")]
    return [
        _allow("robot-admitted", "ingress", ["query"], [ADMITTED]),
        _allow("robot-admitted-reply", "egress", ["reply"], [ADMITTED]),
        _allow("robot-hears-stops", "ingress", ["declare_subscriber"], list(keys.every_stop)),
        _allow("robot-watches-orchestrators", "ingress", tokens, [orchestrators]),
        _allow("robot-is-told", "egress", ["put", "liveliness_token"], heard),
        _allow("robot-is-watched", "egress", ["declare_subscriber"], watched),
        # A stop of several robots at once travels under its own key expression.
        _allow("robot-stops-with-others", "egress", ["put", "query"], [every(f"by/*/{STOP}")]),
    ]


def _office(keys: FleetKeys) -> list[Rule]:
    """Return what orchestrators have in common beside watching: they may see who is connected."""
    return [
        _allow("connected", "ingress", ["query"], [keys.connected]),
        _allow("connected-reply", "egress", ["reply"], [keys.connected]),
    ]


def _robot(keys: FleetKeys, robot: str) -> list[Rule]:
    """Return what one robot may do under its own name."""
    own = [keys.robot(robot, "**"), keys.robot(robot, "state/@adv/**")]
    published = [keys.robot(robot, "state"), keys.robot(robot, "telemetry/*"), own[1]]
    answers = ["reply", "declare_queryable", "liveliness_token"]
    return [
        _allow(f"{robot}/publishes", "ingress", ["put"], published),
        _allow(f"{robot}/answers", "ingress", answers, own),
        _allow(f"{robot}/hears", "ingress", ["declare_subscriber"], own[:1]),
        _allow(f"{robot}/is-asked", "egress", ["query", "put", "declare_subscriber"], own),
    ]


def _stops(keys: FleetKeys, name: str) -> list[Rule]:
    under_name = [f"{keys.every_robot('by')}/{name}/{STOP}", keys.stop(name)]
    return [_allow(f"{name}/stops", "ingress", ["put", "query"], under_name)]


def _commands(keys: FleetKeys, name: str, leaves: tuple[str, ...]) -> Rule:
    under_name = [f"{keys.every_robot('by')}/{name}/{leaf}" for leaf in leaves]
    return _allow(f"{name}/commands", "ingress", ["query"], under_name)


def _allow(rule: str, flow: str, messages: list[str], key_exprs: list[str]) -> Rule:
    return {
        "id": rule,
        "permission": "allow",
        "flows": [flow],
        "messages": messages,
        "key_exprs": key_exprs,
    }


def _small_messages(keys: FleetKeys) -> dict[str, Any]:
    return {
        "id": "small",
        "flows": ["ingress"],
        "messages": ["put", "query", "reply"],
        "key_exprs": [
            *(keys.every_robot(leaf) for leaf in ("state", f"by/*/{STOP}")),
            *keys.every_stop,
        ],
        "size_limit": MAX_STATE_BYTES,
    }
