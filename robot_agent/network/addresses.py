"""Where each robot of an agent reaches its fleet: at one endpoint, or each with its identity."""

from __future__ import annotations

from pathlib import Path

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.shared.wire.identity import address_of, read_identity
from nufleet.shared.wire.openness import LOCAL_ENDPOINT, check_closed, kept_identities


def agent_addresses(
    fleet: FleetFile,
    robots: tuple[str, ...],
    connect: str | None,
    identities: tuple[Path, ...],
    *,
    allow_open: bool,
) -> dict[str, str]:
    """Return the address of the fleet for each robot to serve.

    Args:
        fleet: Content of the fleet file.
        robots: Robots to serve; empty for all of the file, or for those that have an identity.
        connect: Endpoint that the user gave; None for none.
        identities: Identity files that the user gave, each of one robot.
        allow_open: Whether the user accepts an open fleet.

    Raises:
        IdentityError: An identity cannot be used.
        InvalidInputError: An identity belongs to another fleet or to no robot of the file, or a
            robot to serve has none; or the endpoint is open.
    """
    kept = () if identities or connect else kept_identities(of_robots=True)
    if not identities and not kept:
        endpoint = check_closed(connect or LOCAL_ENDPOINT, allow_open=allow_open)
        return dict.fromkeys(robots or fleet.robots, endpoint)
    files = [read_identity(path) for path in identities or kept]
    # The user's folder may also hold identities of robots that another agent serves.
    known = [one for one in files if one.fleet == fleet.name and one.principal in fleet.robots]
    found = {one.principal: one for one in (files if identities else known or files)}
    for robot, identity in found.items():
        if identity.fleet != fleet.name:
            raise InvalidInputError(
                f"{identity.path} belongs to fleet {identity.fleet}, not to {fleet.name}"
            )
        if robot not in fleet.robots:
            raise InvalidInputError(
                f"{identity.path} is the identity of {robot}, which is no robot of the fleet file; "
                f"there are {', '.join(fleet.robots)}"
            )
    missing = [robot for robot in robots if robot not in found]
    if missing:
        raise InvalidInputError(
            f"{missing[0]} has no identity here: there is one for {', '.join(found)}"
        )
    return {robot: address_of(found[robot].path) for robot in robots or found}
