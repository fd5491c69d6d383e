"""Stops many robots at once and finds out which of them did not confirm.

Nothing heavy is imported before the stops are sent, because a person waits for them.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

from nufleet.orchestrator.fleet.discovery import robots_at
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.shared.errors import InvalidInputError, NufleetError, RobotLostError
from nufleet.shared.wire.frame import stop_frame
from nufleet.shared.wire.keys import EVERY_FLEETS_STOP, FleetKeys, robot_in_every_fleet
from nufleet.shared.wire.transport import Session, open_client

if TYPE_CHECKING:
    from nufleet.orchestrator.fleet.client import Fleet

CONNECT_TIMEOUT_S = 5.0
MOST_AT_ONCE = 64

_log = logging.getLogger(__name__)

OnAnswer = Callable[[str, str | None], None]
"""Callback with a robot's name and the reason why it did not confirm its stop, None if it did."""


def stop_at_router(
    endpoint: str,
    robots: tuple[str, ...] | None,
    reason: str,
    *,
    fleet_name: str | None,
    on_answer: OnAnswer,
) -> bool:
    """Stop the named robots, or all robots, and return whether each of them confirmed.

    An ambiguous request is never an error: without a fleet name, every fleet at the router is
    stopped.

    Args:
        endpoint: Endpoint at which the router listens.
        robots: Names of the robots to stop; None stops all.
        reason: Reason for the stop, in any words.
        fleet_name: Name of the fleet; None means every fleet at the router.
        on_answer: Callback for each robot as soon as its answer is known; robots are named
            `fleet/robot` where there are several fleets.

    Raises:
        NoRouterError: No router answers, so no robot can be reached.
        InvalidInputError: The fleet's name is not valid.
        RobotLostError: The stop was sent, but no robot is there that could confirm it.
    """
    sender = new_orchestrator_id()
    order = stop_frame(sender, reason)
    keys = _keys(robots, fleet_name)
    with open_client(endpoint, timeout_s=CONNECT_TIMEOUT_S) as telling:
        for key in keys:
            telling.put_urgent(key, order)
        # Confirmations use a session of their own: a robot that does not read may make the router
        # hold up the session on which the stop was sent.
        with open_client(endpoint, timeout_s=CONNECT_TIMEOUT_S) as asking:
            there = robots_at(asking)
            for fleet, robot in there:
                if fleet_name in (None, fleet) and (robots is None or robot in robots):
                    asking.put_urgent(FleetKeys(fleet).robot(robot, "stop"), order)
            fleets = tuple(sorted({fleet for fleet, _ in there}))
            return _all_confirm(asking, fleets, sender, robots, reason, fleet_name, on_answer)


def stop_robots(fleet: Fleet, robots: tuple[str, ...], reason: str) -> dict[str, str]:
    """Stop the named robots, and return the reason for each robot that did not confirm."""
    unconfirmed: dict[str, str] = {}

    def told(target: _Target, why: str | None) -> None:
        if why is not None:
            unconfirmed[target.robot] = why

    _stop([_Target(fleet, "", robot) for robot in robots], reason, told)
    return unconfirmed


def _keys(robots: tuple[str, ...] | None, fleet_name: str | None) -> list[str]:
    """Return the keys that reach the robots to stop, before it is known which are alive."""
    fleet = None if fleet_name is None else FleetKeys(fleet_name)
    if robots is None:
        return [EVERY_FLEETS_STOP if fleet is None else fleet.stop]
    keys = []
    for robot in robots:
        try:
            in_all = robot_in_every_fleet(robot, "stop")
            keys.append(in_all if fleet is None else fleet.robot(robot, "stop"))
        except InvalidInputError:
            continue  # reported when its confirmation is requested; the others are stopped anyway
    return keys


class _Target(NamedTuple):
    fleet: Fleet
    fleet_name: str
    robot: str


def _all_confirm(
    session: Session,
    there: tuple[str, ...],
    sender: str,
    robots: tuple[str, ...] | None,
    reason: str,
    fleet_name: str | None,
    on_answer: OnAnswer,
) -> bool:
    from nufleet.orchestrator.fleet.client import Fleet

    names = there if fleet_name is None else (fleet_name,)
    fleets = {name: Fleet(session, FleetKeys(name), sender) for name in names}
    asked: set[_Target] = set()
    unconfirmed: set[_Target] = set()

    def told(target: _Target, why: str | None) -> None:
        if why is not None:
            unconfirmed.add(target)
        one = len(fleets) == 1
        on_answer(target.robot if one else f"{target.fleet_name}/{target.robot}", why)

    # Repeat until no new robot appears: some may appear while others are being asked.
    while new := [target for target in _targets(fleets, robots) if target not in asked]:
        asked.update(new)
        _stop(new, reason, told)
    if not asked:
        who = "every robot" if fleet_name is None else f"every robot of fleet {fleet_name}"
        fleets_there = f"the fleets are {', '.join(there)}" if there else "no robot is there"
        raise RobotLostError(
            f"a stop was sent to {who if robots is None else ', '.join(robots)}, "
            f"but no robot confirmed it: {fleets_there}"
        )
    return not unconfirmed


def _targets(fleets: dict[str, Fleet], robots: tuple[str, ...] | None) -> list[_Target]:
    """Return the robots to ask now; named robots are included even if they do not seem alive."""
    there = [_Target(f, name, robot) for name, f in fleets.items() for robot in f.robots()]
    if robots is None:
        return there
    targets = [target for target in there if target.robot in robots]
    seen = {target.robot for target in targets}
    missing = [robot for robot in robots if robot not in seen]
    return targets + [_Target(f, name, robot) for name, f in fleets.items() for robot in missing]


def _stop(targets: list[_Target], reason: str, told: Callable[[_Target, str | None], None]) -> None:
    """Stop all robots at once, and report the answer of each as soon as it is known."""
    from concurrent.futures import ThreadPoolExecutor, as_completed

    def stop_one(target: _Target) -> str | None:
        try:
            target.fleet.stop(target.robot, reason)
        except NufleetError as error:
            return str(error)
        except Exception as error:  # noqa: BLE001 - one robot's trouble must not hide the others'
            _log.exception("the stop of %r failed", target.robot)
            return f"an unexpected error: {error!r}"
        return None

    with ThreadPoolExecutor(max(1, min(MOST_AT_ONCE, len(targets)))) as pool:
        asked = {pool.submit(stop_one, target): target for target in targets}
        for done in as_completed(asked):
            told(asked[done], done.result())
