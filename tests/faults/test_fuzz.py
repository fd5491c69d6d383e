"""All malformed bytes are refused with a reason; their receiver lives on and stays small.

A share of `python -m benchmarks.faults fuzz`, which does it a hundred thousand times.
"""

from __future__ import annotations

import logging
from pathlib import Path

import numpy as np
import pytest
from child_processes import children_of
from polling import PATIENCE_S

from benchmarks.faults.fuzz_agent import LEAVES, assert_serves, fuzz_agent
from benchmarks.faults.fuzz_targets import (
    decoding_targets,
    every_type_of_message,
    example_messages,
    file_targets,
)
from benchmarks.faults.fuzzing import EscapedError, Mutator, Target, fuzz, resident_bytes
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.processes import FleetProcesses
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.transport import open_client

GROWTH_MAX_BYTES = 32 * 2**20
"""By which a process may grow over all payloads of a test: caches and fragments, no payloads."""

FLEET = """
schema = 1
name = "lab"

[robots.a]
driver = "double_integrator"
settings = { alpha = 1.0, beta = 0.003 }
"""


@pytest.fixture(autouse=True)
def _quiet() -> None:
    """Suppress the errors that a thousand damaged journals log."""
    logging.getLogger("nufleet.robot_agent.journal.journal").disabled = True


def test_there_is_an_example_of_every_message() -> None:
    assert {type(message) for message in example_messages()} == set(every_type_of_message())


def test_the_fuzzer_finds_what_escapes() -> None:
    def fragile(payload: bytes) -> None:
        if payload.startswith(b"\xff"):
            raise KeyError(payload[:1])
        if len(payload) != 4:
            raise MalformedMessageError("four bytes")

    target = Target("fragile", [b"good"], fragile, (MalformedMessageError,))
    with pytest.raises(EscapedError, match=r"fragile: .* escaped as KeyError"):
        fuzz(target, 5000, np.random.default_rng(0))


def test_the_same_generator_gives_the_same_payloads() -> None:
    first, again = (Mutator(np.random.default_rng(5), [b"seed one", b"two"]) for _ in range(2))
    assert [first.payload() for _ in range(200)] == [again.payload() for _ in range(200)]


def test_no_message_escapes_its_decoder() -> None:
    rng = np.random.default_rng(1)
    targets = decoding_targets()
    for target in targets:
        fuzz(target, 20, rng)
    before = resident_bytes()
    for target in targets:
        tally = fuzz(target, 400, rng)
        assert sum(tally.refusals.values()) + tally.accepted == tally.payloads
        assert tally.slowest_s < 2.0
    assert resident_bytes() - before < GROWTH_MAX_BYTES


def test_no_file_escapes_its_reader(tmp_path: Path) -> None:
    rng = np.random.default_rng(2)
    targets = file_targets(tmp_path)
    for target in targets:
        fuzz(target, 20, rng)
    before = resident_bytes()
    for target in targets:
        assert fuzz(target, 150, rng).slowest_s < 2.0
    assert resident_bytes() - before < GROWTH_MAX_BYTES


def test_a_live_agent_answers_every_request_and_serves_afterwards(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(FLEET)
    keys = FleetKeys("lab")
    endpoint = f"unixsock-stream/{tmp_path}/r.sock"
    with FleetProcesses() as started:
        started.start_router(endpoint)
        started.start_agents(path, [("a",)], endpoint, None, state_folder=tmp_path)
        with open_client(endpoint, timeout_s=PATIENCE_S) as session:
            fleet = Fleet(session, keys, "orchestrator-1")
            fleet.wait_for(("a",), timeout_s=PATIENCE_S)
            boot_id = fleet.describe("a").boot_id
            rng = np.random.default_rng(3)
            fuzz_agent(session, keys, "a", 300, rng)
            (agent,) = children_of(named="agent")
            before = resident_bytes(agent.pid)
            tallies = fuzz_agent(session, keys, "a", 1500, rng)
            # Every key answered, and some requests were valid by chance.
            assert len(tallies) == len(LEAVES) + 1
            assert all(tally.payloads for tally in tallies)
            assert sum(tally.accepted for tally in tallies) > 50
            assert_serves(fleet, "a")
            assert resident_bytes(agent.pid) - before < GROWTH_MAX_BYTES
            assert fleet.describe("a").boot_id == boot_id
            assert started.dead() == []
