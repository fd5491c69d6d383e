"""A robot that is there and does not answer at once is asked to describe itself again."""

from __future__ import annotations

from typing import Any, cast

import pytest
from puppet_robot import puppet_spec

from nufleet.orchestrator.fleet.client import DESCRIBE_TRIES, Fleet
from nufleet.shared.errors import NoReplyError
from nufleet.shared.wire.codec import encode
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import Description
from nufleet.shared.wire.session import Session

KEYS = FleetKeys("lab")
DESCRIPTION = Description(robot="a", boot_id="boot", spec=puppet_spec())


class Network:
    """A session on which robot a is there, or not, and answers only a later question."""

    identity = None

    def __init__(self, *, alive: bool, answers_at: int) -> None:
        self.alive, self.answers_at, self.asked = alive, answers_at, 0

    def watch_alive(self, _key: str, handler: Any) -> None:
        if self.alive:
            handler(KEYS.robot("a", "alive"), True)

    def ask_all(self, _key: str, _payload: bytes, *, timeout_s: float) -> list[bytes]:
        del timeout_s
        self.asked += 1
        return [encode(DESCRIPTION)] if self.asked == self.answers_at else []

    def declare_alive(self, _key: str) -> None:
        """Do nothing."""

    def subscribe_state(self, _key: str, _handler: Any) -> None:
        """Do nothing."""

    def subscribe(self, _key: str, _handler: Any, *, max_bytes: int) -> None:
        """Do nothing."""


def fleet_on(network: Network) -> Fleet:
    return Fleet(cast(Session, network), KEYS, "orchestrator-1")


def test_a_robot_that_is_there_is_asked_again() -> None:
    network = Network(alive=True, answers_at=DESCRIBE_TRIES)
    assert fleet_on(network).describe_all(("a",)) == {"a": DESCRIPTION}


@pytest.mark.parametrize(("alive", "asked"), [(True, DESCRIBE_TRIES), (False, 1)])
def test_one_that_stays_silent_or_is_gone_does_not_answer(alive: bool, asked: int) -> None:
    network = Network(alive=alive, answers_at=99)
    with pytest.raises(NoReplyError, match="robot a does not answer: is its agent running"):
        fleet_on(network).describe("a")
    assert network.asked == asked
