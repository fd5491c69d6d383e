"""Files that are made to do harm: refused in words, and nothing in them runs."""

from __future__ import annotations

import json
import pickle
import struct
from collections.abc import Callable
from pathlib import Path

import pytest

from benchmarks.faults.fuzz_targets import experience
from benchmarks.faults.lab import Lab
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.orchestrator.gap.model_files import read_model
from nufleet.shared.errors import InvalidInputError, MalformedMessageError, RefusedError
from nufleet.shared.experience.file import decode_experience, digest, encode_experience
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.robots.fleet_file import read_fleet_file
from nufleet.shared.wire.messages import Outcome

SHORT = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)


class Trap:
    """An object that creates a file when it is unpickled."""

    def __init__(self, trace: Path) -> None:
        self._trace = trace

    def __reduce__(self) -> tuple[Callable[..., object], tuple[str]]:
        return Path.touch, (self._trace,)  # type: ignore[return-value]


def header_that_lies(change: Callable[[dict[str, object]], None]) -> bytes:
    """An experience whose safetensors header was changed."""
    payload = encode_experience(experience())
    (length,) = struct.unpack("<Q", payload[:8])
    header = json.loads(payload[8 : 8 + length])
    change(header)
    said = json.dumps(header).encode()
    return struct.pack("<Q", len(said)) + said + payload[8 + length :]


def larger(header: dict[str, object]) -> None:
    tensor = next(value for key, value in header.items() if key != "__metadata__")
    assert isinstance(tensor, dict)
    tensor["shape"] = [2**40, 2**20]


def overlapping(header: dict[str, object]) -> None:
    tensors = [value for key, value in header.items() if key != "__metadata__"]
    for tensor in tensors:
        assert isinstance(tensor, dict)
        tensor["data_offsets"] = [0, 2**62]


@pytest.fixture
def hostile(tmp_path: Path) -> dict[str, bytes]:
    trap = Trap(tmp_path / "trace")
    assert pickle.loads(pickle.dumps(trap)) is None  # noqa: S301 - it works where it is run
    assert (tmp_path / "trace").exists()
    (tmp_path / "trace").unlink()
    return {
        **{
            f"pickle {n}": pickle.dumps(trap, protocol=n)
            for n in range(pickle.HIGHEST_PROTOCOL + 1)
        },
        "a length that lies": struct.pack("<Q", 2**63) + b"{}",
        "a header of 4 GiB": struct.pack("<Q", 2**32) + b"{" * 1000,
        "a tensor of 2**60 numbers": header_that_lies(larger),
        "tensors in one place": header_that_lies(overlapping),
    }


def test_no_reader_runs_what_is_in_a_file(tmp_path: Path, hostile: dict[str, bytes]) -> None:
    readers = {
        ".toml": read_fleet_file,
        ".json": read_model,
        ".csv": read_model,
        ".svg": read_drawing,
        ".npz": read_model,
        ".pt": read_model,
    }
    for payload in hostile.values():
        with pytest.raises(MalformedMessageError):
            decode_experience(payload)
        for suffix, read in readers.items():
            path = tmp_path / f"model{suffix}"
            path.write_bytes(payload)
            with pytest.raises(InvalidInputError, match="model"):
                read(path)
    assert not (tmp_path / "trace").exists()


def test_an_agent_refuses_hostile_models_and_serves_on(
    lab: Lab, tmp_path: Path, hostile: dict[str, bytes]
) -> None:
    lab.describe_section_v({"a": 0.9})
    lab.router()
    agent = lab.agent("a")
    fleet = lab.orchestrator("a")
    for payload in hostile.values():
        for slot in ("experience", "prior"):
            with pytest.raises(RefusedError) as raised:
                fleet.install("a", slot, payload, digest(payload))  # type: ignore[arg-type]
            assert raised.value.code == "malformed"
    description = fleet.describe("a")
    assert (description.experiences, description.prior) == ((), None)
    assert GoalRunner(fleet).run("a", "g", SHORT).outcome is Outcome.COMPLETED
    assert agent.running
    assert not (tmp_path / "trace").exists()
