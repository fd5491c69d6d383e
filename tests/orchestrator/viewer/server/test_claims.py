"""Ports for the viewer's server are free, and apart from one another."""

from __future__ import annotations

import socket

import pytest

from nufleet.orchestrator.viewer.server.claims import claim_port
from nufleet.shared.errors import EndpointInUseError


class FirstThree(set[int]):
    """Contains the first three ports that are asked for, as if others had claimed them."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[object] = []

    def __contains__(self, port: object) -> bool:
        self.asked.append(port)
        return len(self.asked) <= 3


def test_a_port_that_was_claimed_before_is_not_claimed_again() -> None:
    claimed = FirstThree()
    port = claim_port("127.0.0.1", 0, apart_from=claimed)
    assert claimed.asked[3:] == [port]
    assert len(set(claimed.asked)) == 4


def test_a_port_that_is_asked_for_is_refused_when_it_is_taken_and_never_replaced() -> None:
    with socket.socket() as other:
        other.bind(("127.0.0.1", 0))
        other.listen()
        port = int(other.getsockname()[1])
        with pytest.raises(EndpointInUseError, match=f":{port}:"):
            claim_port("127.0.0.1", port, apart_from=(port,))
