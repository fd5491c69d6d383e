"""Messages of another version of the protocol: refused by name before anything moves."""

from __future__ import annotations

import json
import struct

import pytest

from benchmarks.faults.fuzz_agent import LEAVES
from benchmarks.faults.fuzz_targets import example_messages
from benchmarks.faults.lab import KEYS, Lab
from benchmarks.faults.program import PATIENCE_S
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.errors import ProtocolVersionError
from nufleet.shared.wire.codec import decode, encode
from nufleet.shared.wire.frame import PROTOCOL_VERSION
from nufleet.shared.wire.messages import Description, Refusal, RobotStatus
from nufleet.shared.wire.transport import open_client

OTHERS = (PROTOCOL_VERSION - 1, PROTOCOL_VERSION + 1)


def of_version(payload: bytes, version: int) -> bytes:
    """A message as a program of another version would send it."""
    header_bytes, body_bytes = struct.unpack_from("<II", payload, 4)
    header = json.loads(payload[12 : 12 + header_bytes])
    said = json.dumps({**header, "protocol": version}).encode()
    rest = payload[12 + header_bytes :]
    return payload[:4] + struct.pack("<II", len(said), body_bytes) + said + rest


def test_an_agent_refuses_every_request_of_another_version_and_stays_at_rest(lab: Lab) -> None:
    lab.describe_section_v({"a": 0.9})
    lab.router()
    lab.agent("a")
    fleet = lab.orchestrator("a")
    asked = set()
    with open_client(lab.endpoint, timeout_s=PATIENCE_S) as session:
        for leaf, kind in LEAVES.items():
            for message in (one for one in example_messages() if isinstance(one, kind)):
                for version in OTHERS:
                    asked.add(leaf)
                    payload = of_version(encode(message), version)
                    key = KEYS.request("a", "me", leaf)
                    (reply,) = session.ask_all(key, payload, timeout_s=PATIENCE_S)
                    refusal = decode(reply, Refusal)
                    assert refusal.code == "malformed"
                    assert f"protocol version {version}" in refusal.reason
                    assert f"speaks {PROTOCOL_VERSION}" in refusal.reason
    assert asked == set(LEAVES)
    assert lab.motions("a") == []
    # A stop that cannot be read stops all the same.
    lab.wait_for_state(fleet, "a", lambda state: state.status is RobotStatus.STOPPED)


@pytest.mark.parametrize("version", OTHERS)
def test_an_orchestrator_names_the_robot_that_speaks_another_version(
    lab: Lab, version: int
) -> None:
    lab.router()
    description = next(m for m in example_messages() if isinstance(m, Description))
    with open_client(lab.endpoint, timeout_s=PATIENCE_S) as session:
        answer = of_version(encode(description), version)
        session.serve(KEYS.robot("old", "**"), lambda request: request.answer(answer))
        session.declare_alive(KEYS.robot("old", "alive"))
        fleet: Fleet = lab.orchestrator("old")
        words = rf"robot old .* protocol version {version}, this side speaks {PROTOCOL_VERSION}"
        with pytest.raises(ProtocolVersionError, match=words):
            fleet.describe("old")
