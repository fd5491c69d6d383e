"""Malformed payloads for every decoder, reader and key: how many, what escaped, what memory."""

from __future__ import annotations

import logging
import tempfile
from pathlib import Path

import numpy as np

from benchmarks.faults.figure import Figure
from benchmarks.faults.fuzz_agent import assert_serves, fuzz_agent
from benchmarks.faults.fuzz_targets import decoding_targets, file_targets
from benchmarks.faults.fuzzing import Tally, Target, fuzz, resident_bytes
from benchmarks.faults.lab import KEYS, opened_lab
from benchmarks.faults.program import PATIENCE_S
from nufleet.shared.wire.transport import open_client

GROWTH_MAX_MIB = 32.0
MIB = 2**20
WARM_UP = 200


def figures(payloads: int, requests: int) -> list[Figure]:
    """Measure; raises EscapedError with the payload when one escapes."""
    logging.disable(logging.CRITICAL)  # every damaged journal would log an error
    try:
        return [*_in_process(payloads), *_over_the_network(requests)]
    finally:
        logging.disable(logging.NOTSET)


def _in_process(payloads: int) -> list[Figure]:
    rng = np.random.default_rng(11)
    # In memory: it is not the disk that is measured.
    memory = "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108
    with tempfile.TemporaryDirectory(dir=memory) as folder:
        targets: list[Target] = [*decoding_targets(), *file_targets(Path(folder))]
        for target in targets:
            fuzz(target, WARM_UP, rng)
        before = resident_bytes()
        tallies = [fuzz(target, payloads, rng) for target in targets]
        growth = (resident_bytes() - before) / MIB
    return _summary("in process", tallies, growth)


def _over_the_network(requests: int) -> list[Figure]:
    rng = np.random.default_rng(12)
    with tempfile.TemporaryDirectory() as folder, opened_lab(Path(folder)) as lab:
        lab.describe_section_v({"a": 0.9})
        lab.router()
        agent = lab.agent("a")
        fleet = lab.orchestrator("a")
        with open_client(lab.endpoint, timeout_s=PATIENCE_S) as session:
            fuzz_agent(session, KEYS, "a", requests // 10, rng)
            before = resident_bytes(agent.pid)
            tallies = fuzz_agent(session, KEYS, "a", requests, rng)
            growth = (resident_bytes(agent.pid) - before) / MIB
        assert_serves(fleet, "a")
    return _summary("to a live agent", tallies, growth)


def _summary(where: str, tallies: list[Tally], growth_mib: float) -> list[Figure]:
    total = sum(tally.payloads for tally in tallies)
    accepted = sum(tally.accepted for tally in tallies)
    slowest = max(tallies, key=lambda tally: tally.slowest_s)
    return [
        Figure(
            f"malformed payloads {where} that escaped",
            0.0,
            "",
            0.0,
            {"of": total, "valid by chance": accepted, "targets": len(tallies)},
        ),
        Figure(f"growth of memory meanwhile, {where}", growth_mib, "MiB", GROWTH_MAX_MIB),
        Figure(
            f"slowest answer, {where}", 1e3 * slowest.slowest_s, "ms", None, {"by": slowest.target}
        ),
    ]
