"""The keys that an agent serves are those for which the router of a closed fleet has rules."""

from __future__ import annotations

from typing import Any

import pytest
from fleet_lab import KEYS, Lab
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.robot_agent import agent as agent_module
from nufleet.robot_agent.network.endpoint import Endpoint
from nufleet.shared.wire.codec import decode, encode
from nufleet.shared.wire.keys import COMMANDS, READS, RELEASE, STOP
from nufleet.shared.wire.messages import DescribeRequest, Refusal


def test_an_agent_serves_what_the_router_knows_and_nothing_else(
    lab: Lab, monkeypatch: pytest.MonkeyPatch
) -> None:
    served: dict[str, Any] = {}

    class Recorded(Endpoint):
        def __init__(self, *arguments: Any, **named: Any) -> None:
            served.update(named)
            super().__init__(*arguments, **named)

    monkeypatch.setattr(agent_module, "Endpoint", Recorded)
    lab.agent("a", PuppetRobot())
    assert set(served["handlers"]) == set(READS)
    assert set(served["commands"]) == {*COMMANDS, RELEASE}
    assert set(served["urgent"]) == {STOP}


@pytest.mark.parametrize("leaf", [*COMMANDS, RELEASE])
def test_a_command_that_names_no_principal_is_refused(leaf: str, lab: Lab) -> None:
    lab.agent("a", PuppetRobot())
    session = lab.session()
    key = KEYS.robot("a", leaf)
    replies: list[bytes] = []

    def answered() -> bool:
        # A session that was just opened may not know yet that the agent serves this key.
        replies[:] = session.ask_all(key, encode(DescribeRequest()), timeout_s=PATIENCE_S)
        return bool(replies)

    wait_until(answered)
    (reply,) = replies
    refusal = decode(reply, Refusal)
    assert refusal.code == "unknown-key"
