"""Gives a robot experiences, and gives it back the prior that it had."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.shared.errors import MalformedMessageError, NufleetError
from nufleet.shared.experience.file import digest
from nufleet.shared.wire.messages import Description, ExperienceOffer

REST_PATIENCE_S = 30.0
"""How long an interrupted robot may take to come to rest before its prior is left as it is."""

_log = logging.getLogger(__name__)


def install(
    fleet: Fleet, robot: str, slot: Literal["experience", "prior"], payload: bytes
) -> ExperienceOffer:
    """Install an experience on a robot and read it back.

    Raises:
        RefusedError: it does not fit the robot.
        MalformedMessageError: what the robot has now is not what was sent.
    """
    sha256 = digest(payload)
    offer = fleet.install(robot, slot, payload, sha256)
    if offer.sha256 != sha256 or fleet.fetch(robot, sha256) != payload:
        raise MalformedMessageError(f"robot {robot} does not hold what was installed on it")
    return offer


@contextmanager
def prior_put_back(fleet: Fleet, pilot: Pilot, description: Description) -> Iterator[None]:
    """Give a robot back, in the end, the prior that it has now, or none.

    Also when what is done meanwhile fails or is interrupted: a robot that flies then is brought to
    rest first, and that error is the one raised.

    Args:
        fleet: the robot's.
        pilot: flies it.
        description: of the robot, now.
    """
    robot = description.robot
    before = None if description.prior is None else fleet.fetch(robot, description.prior.sha256)

    def put_back() -> None:
        if before is None:
            fleet.remove_prior(robot)
        else:
            install(fleet, robot, "prior", before)

    try:
        yield
    except BaseException as error:
        if not isinstance(error, Exception):
            # Ctrl-C comes while the robot flies, when nothing can be changed on it.
            pilot.interrupt()
            fleet.watch(robot).wait_until(
                lambda w: w.state is not None and w.state.goal_id is None,
                timeout_s=REST_PATIENCE_S,
            )
        try:
            put_back()
        except NufleetError as left:
            _log.warning("the prior of %s is not the one that it had: %s", robot, left)
        raise
    put_back()
