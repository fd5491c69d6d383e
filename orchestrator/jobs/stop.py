"""The work of `nufleet stop` and `nufleet release`.

Nothing heavy is imported before the stops are sent, because a person waits for them.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeVar

import click

from nufleet.orchestrator.fleet.discovery import robots_at
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.shared.errors import InvalidInputError, NufleetError, RefusedError, RobotLostError
from nufleet.shared.wire.frame import NOT_KILLED, new_order_id, stop_frame
from nufleet.shared.wire.keys import (
    STOP,
    FleetKeys,
    every_fleets_stop,
    robot_in_every_fleet,
)
from nufleet.shared.wire.session import Session
from nufleet.shared.wire.transport import open_client

if TYPE_CHECKING:
    from nufleet.orchestrator.fleet.client import Fleet

CONNECT_TIMEOUT_S = 5.0
MOST_AT_ONCE = 64

T = TypeVar("T")

_log = logging.getLogger(__name__)


def stop_fleets(
    addresses: tuple[str, ...],
    fleet_name: str | None,
    robots: tuple[str, ...] | None,
    reason: str,
    *,
    kill: bool = False,
) -> bool:
    """Stop robots at several addresses at the same time; see `stop_and_print`.

    An error at one address neither delays nor prevents the stop at the others.

    Raises:
        NufleetError: The error of the only address.
    """
    if len(addresses) == 1:
        return stop_and_print(addresses[0], fleet_name, robots, reason, kill=kill)
    from concurrent.futures import ThreadPoolExecutor, as_completed

    confirmed = True
    with ThreadPoolExecutor(len(addresses)) as pool:
        stops = {
            pool.submit(stop_and_print, address, fleet_name, robots, reason, kill=kill): address
            for address in addresses
        }
        for stop in as_completed(stops):
            try:
                confirmed &= stop.result()
            except NufleetError as error:
                confirmed = False
                _print_failure(f"{stops[stop]}: {error}")
    return confirmed


def stop_and_print(
    endpoint: str,
    fleet_name: str | None,
    robots: tuple[str, ...] | None,
    reason: str,
    *,
    kill: bool = False,
) -> bool:
    """Stop the named robots, or all robots, and return whether each of them confirmed.

    An ambiguous request is never an error: without a fleet name, every fleet at the router is
    stopped. The answer of each robot is printed as soon as it is known; robots are named
    `fleet/robot` where there are several fleets.

    Args:
        endpoint: Endpoint at which the router listens.
        fleet_name: Name of the fleet; None means every fleet at the router.
        robots: Names of the robots to stop; None stops all.
        reason: Reason for the stop, in any words.
        kill: Whether to cut the motors instead of bringing the robots to rest.

    Raises:
        NoRouterError: No router answers, so no robot can be reached.
        InvalidInputError: The fleet's name is not valid.
        RobotLostError: The stop was sent, but no robot is there that could confirm it.
    """
    with open_client(endpoint, timeout_s=CONNECT_TIMEOUT_S) as telling:
        principal = telling.principal
        sender = new_orchestrator_id(principal)
        order_id = new_order_id()
        order = _Order(sender, reason, kill, order_id)
        frame = stop_frame(sender, reason, order_id=order_id, kill=kill)
        if telling.identity is not None:
            # A stop asks no questions: another fleet's name is not known to this router anyway.
            fleet_name = telling.identity.fleet
        keys = _keys(robots, fleet_name, principal)
        for key in keys:
            telling.put_urgent(key, frame)
        if os.getpriority(os.PRIO_PROCESS, 0) < 0:
            # From now on the robots' own programs need the processor more than this one.
            os.setpriority(os.PRIO_PROCESS, 0, 0)
        # Confirmations use a session of their own: a robot that does not read may make the router
        # hold up the session on which the stop was sent.
        with open_client(endpoint, timeout_s=CONNECT_TIMEOUT_S) as asking:
            for key in keys:
                asking.put_urgent(key, frame)
            fleets = tuple(sorted({fleet for fleet, _ in robots_at(asking)}))
            return _all_confirm(asking, fleets, order, robots, fleet_name)


def release_and_print(endpoint: str, fleet_name: str | None, robots: tuple[str, ...]) -> bool:
    """Release the named robots, print the answer of each, and return whether all may move again.

    Args:
        endpoint: Endpoint at which the router listens.
        fleet_name: Name of the fleet; None when only one is running there.
        robots: Names of the robots to release.

    Raises:
        NoRouterError: No router answers.
        InvalidInputError: There is no fleet, or there are several and none was named.
    """
    from nufleet.orchestrator.fleet.connection import running_fleet

    refused: set[str] = set()

    def told(robot: str, why: NufleetError | None) -> None:
        if why is None:
            click.echo(f"{robot} may move again", err=True)
        else:
            refused.add(robot)
            _print_failure(f"{robot} was not released: {why}")

    with running_fleet(endpoint, fleet_name) as connection:
        _ask_at_once(robots, connection.fleet.release, told)
    return not refused


def stop_robots(fleet: Fleet, robots: tuple[str, ...], reason: str) -> dict[str, str]:
    """Stop the named robots, and return the reason for each robot that did not confirm."""
    unconfirmed: dict[str, str] = {}

    def told(target: _Target, why: NufleetError | None) -> None:
        if why is not None:
            unconfirmed[target.robot] = str(why)

    order = _Order(fleet.orchestrator_id, reason, False, None)
    _stop([_Target(fleet, "", robot) for robot in robots], order, told)
    return unconfirmed


def _keys(robots: tuple[str, ...] | None, fleet_name: str | None, principal: str) -> list[str]:
    """Return the keys that reach the robots to stop, before it is known which are alive."""
    fleet = None if fleet_name is None else FleetKeys(fleet_name)
    if robots is None:
        return [every_fleets_stop(principal) if fleet is None else fleet.stop(principal)]
    keys = []
    for robot in robots:
        try:
            in_all = robot_in_every_fleet(robot, f"by/{principal}/{STOP}")
            keys.append(in_all if fleet is None else fleet.command(robot, principal, STOP))
        except InvalidInputError:
            continue  # reported when its confirmation is requested; the others are stopped anyway
    return keys


class _Order(NamedTuple):
    """A stop of which a robot gets several copies, and obeys one."""

    sender: str
    reason: str
    kill: bool
    order_id: str | None
    """Id of an order that has been sent already; None to send each robot one of its own."""


class _Target(NamedTuple):
    fleet: Fleet
    fleet_name: str
    robot: str


def _all_confirm(
    session: Session,
    there: tuple[str, ...],
    order: _Order,
    robots: tuple[str, ...] | None,
    fleet_name: str | None,
) -> bool:
    from nufleet.orchestrator.fleet.client import Fleet

    names = there if fleet_name is None else (fleet_name,)
    fleets = {name: Fleet(session, FleetKeys(name), order.sender) for name in names}
    asked: set[_Target] = set()
    unconfirmed: set[_Target] = set()
    not_cut: set[_Target] = set()

    def told(target: _Target, why: NufleetError | None) -> None:
        name = target.robot if len(fleets) == 1 else f"{target.fleet_name}/{target.robot}"
        if why is None:
            click.echo(f"{name} is stopped{', its motors are cut' if order.kill else ''}", err=True)
        elif isinstance(why, RefusedError) and why.code == NOT_KILLED:
            not_cut.add(target)
            _print_failure(f"{name}: {why.reason}")
        else:
            unconfirmed.add(target)
            _print_failure(f"{name} DID NOT CONFIRM ITS STOP: {why}")

    # Repeat until no new robot appears: some may appear while others are being asked.
    while new := [target for target in _targets(fleets, robots) if target not in asked]:
        asked.update(new)
        _stop(new, order, told)
    if not asked:
        session.check_admitted()
        everyone = "all robots" if fleet_name is None else f"all robots of fleet {fleet_name}"
        found = f"fleets {', '.join(there)}" if there else "no robots"
        raise RobotLostError(
            f"a stop was sent to {everyone if robots is None else ', '.join(robots)}, "
            f"but no robot can confirm it: there are {found} at the router"
        )
    if unconfirmed:
        _print_failure("Stop these robots by hand.")
    return not unconfirmed and not not_cut


def _targets(fleets: dict[str, Fleet], robots: tuple[str, ...] | None) -> list[_Target]:
    """Return the robots to ask now; named robots are included even if they do not seem alive."""
    there = [_Target(f, name, robot) for name, f in fleets.items() for robot in f.robots()]
    if robots is None:
        return there
    targets = [target for target in there if target.robot in robots]
    seen = {target.robot for target in targets}
    missing = [robot for robot in robots if robot not in seen]
    return targets + [_Target(f, name, robot) for name, f in fleets.items() for robot in missing]


def _print_failure(sentence: str) -> None:
    click.secho(sentence, fg="red", bold=True, err=True)


def _stop(
    targets: list[_Target], order: _Order, told: Callable[[_Target, NufleetError | None], None]
) -> None:
    """Stop all robots at once, and report the answer of each as soon as it is known."""

    def ask(target: _Target) -> None:
        target.fleet.stop(target.robot, order.reason, kill=order.kill, order_id=order.order_id)

    _ask_at_once(targets, ask, told)


def _ask_at_once(
    targets: Sequence[T], ask: Callable[[T], None], told: Callable[[T, NufleetError | None], None]
) -> None:
    """Ask all targets at once; report why each one failed, or None, as soon as it is known."""
    from concurrent.futures import ThreadPoolExecutor, as_completed

    def ask_one(target: T) -> NufleetError | None:
        try:
            ask(target)
        except NufleetError as error:
            return error
        except Exception as error:  # noqa: BLE001 - one robot's trouble must not hide the others'
            _log.exception("asking %r failed", target)
            return NufleetError(f"an unexpected error: {error!r}")
        return None

    with ThreadPoolExecutor(max(1, min(MOST_AT_ONCE, len(targets)))) as pool:
        asked = {pool.submit(ask_one, target): target for target in targets}
        for done in as_completed(asked):
            told(asked[done], done.result())
