"""Where each robot of an agent reaches its fleet: at one endpoint, or each with its identity."""

from __future__ import annotations

from pathlib import Path

from nufleet.shared.errors import InvalidInputError
from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.shared.wire.identity import address_of, identity_at, read_identity
from nufleet.shared.wire.openness import chosen_address


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
    files = identities
    if not files:
        address = chosen_address(connect, None, allow_open=allow_open)
        only = identity_at(address)
        if only is None:
            return dict.fromkeys(robots or fleet.robots, address)
        files = (only.path,)
    found = {identity.principal: identity for identity in map(read_identity, files)}
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
