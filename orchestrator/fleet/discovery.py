"""Finds the robots at a router without joining any fleet; light enough for an urgent stop."""

from __future__ import annotations

from nufleet.shared.wire.keys import EVERY_FLEETS_ROBOTS_ALIVE, FleetKeys, fleet_of
from nufleet.shared.wire.session import Session

DISCOVERY_TIMEOUT_S = 3.0


def robots_at(session: Session) -> tuple[tuple[str, str], ...]:
    """Return the fleet and the name of every robot that is alive at a router, sorted.

    With an identity, these are the robots of its own fleet; the router shows no others. Tokens that
    are not valid names are ignored. Call this before the session watches any tokens.
    """
    identity = session.identity
    everywhere = EVERY_FLEETS_ROBOTS_ALIVE
    if identity is not None:
        everywhere = FleetKeys(identity.fleet).every_robot("alive")
    keys = session.alive(everywhere, timeout_s=DISCOVERY_TIMEOUT_S)
    found = set()
    for key in keys:
        fleet = fleet_of(key)
        robot = None if fleet is None else FleetKeys(fleet).robot_of(key)
        if fleet is not None and robot is not None:
            found.add((fleet, robot))
    return tuple(sorted(found))
