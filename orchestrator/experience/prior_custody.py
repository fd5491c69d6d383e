"""Installs experiences on a robot, and restores the prior that it held before."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal, NamedTuple

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.shared.errors import MalformedMessageError, NufleetError
from nufleet.shared.experience.file import digest, signed_content
from nufleet.shared.wire.messages import Description

REST_PATIENCE_S = 30.0
"""Limit on the time that an interrupted robot may take to come to rest before its prior is
restored. A robot that still moves then may refuse the change and keep the prior it has."""


class Installed(NamedTuple):
    """The file of an experience that a robot holds."""

    sha256: str
    """SHA-256 of the file, in hexadecimal."""
    payload: bytes
    """Its contents."""


_log = logging.getLogger(__name__)


def install(
    fleet: Fleet,
    robot: str,
    slot: Literal["experience", "prior"],
    payload: bytes,
    *,
    beside: bool = False,
) -> Installed:
    """Install an experience on a robot and read it back.

    Args:
        fleet: Client of the robot's fleet.
        robot: Name of the robot.
        slot: `experience` for one that the robot offers to others, `prior` for one it flies with.
        payload: Content of the experience's file.
        beside: Whether a prior joins those that the robot holds; otherwise it takes their place.

    Returns:
        The file that the robot now holds.

    Raises:
        RefusedError: The experience does not fit the robot, or the robot does not trust it.
        MalformedMessageError: The robot does not hold what was sent.
    """
    offer = fleet.install(robot, slot, payload, digest(payload), beside=beside)
    held = fleet.fetch(robot, offer.sha256)
    # In a closed fleet the robot has added its signature to what it learned itself.
    if digest(held) != offer.sha256 or signed_content(held) != signed_content(payload):
        raise MalformedMessageError(f"robot {robot} does not hold what was installed on it")
    return Installed(offer.sha256, held)


@contextmanager
def prior_put_back(fleet: Fleet, pilot: Pilot, description: Description) -> Iterator[None]:
    """Restore, on leaving the context, the priors that a robot holds on entering it, if any.

    The priors are also restored when the body fails or is interrupted. A robot that is flying then
    is brought to rest first, and the body's error is the one that is raised; a failure to restore
    the priors is logged.

    Args:
        fleet: Client of the robot's fleet.
        pilot: Pilot that has the robot fly.
        description: Current description of the robot, which says whether it holds a prior.
    """
    robot = description.robot
    before = [fleet.fetch(robot, prior.sha256) for prior in description.priors]

    def put_back() -> None:
        if not before:
            fleet.remove_prior(robot)
        for place, payload in enumerate(before):
            install(fleet, robot, "prior", payload, beside=place > 0)

    try:
        yield
    except BaseException as error:
        if not isinstance(error, Exception):
            # Ctrl-C arrives while the robot flies, and a flying robot accepts no new prior.
            pilot.interrupt()
            fleet.watch(robot).wait_until(
                lambda w: w.state is not None and w.state.goal_id is None,
                timeout_s=REST_PATIENCE_S,
            )
        try:
            put_back()
        except NufleetError as left:
            _log.warning("the former prior of %s could not be restored: %s", robot, left)
        raise
    put_back()
