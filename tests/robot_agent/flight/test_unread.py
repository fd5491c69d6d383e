"""Frequency tests are kept as they are, and learned from when a robot is asked about itself."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from robots_that_learn import double_integrator

from nufleet.robot_agent.flight import unread
from nufleet.robot_agent.flight.learning import learn
from nufleet.robot_agent.flight.memory import Memory, MemoryFolderError
from nufleet.robot_agent.flight.state_model import state_evidence
from nufleet.robot_agent.flight.unread import UnreadTest, unread_test
from nufleet.shared.arrays import FloatArray
from nufleet.shared.wire import codec

SPEC = double_integrator().spec
NAMES = ("position", "velocity")
OMEGA_RAD_S = 3.0
SAMPLES = 600


def signals(seed: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    """References, outputs and the states at every 64th sample of a test."""
    rng = np.random.default_rng(seed)
    times_s = SPEC.sample_time_s * np.arange(SAMPLES)
    references = np.sin(OMEGA_RAD_S * times_s)[:, np.newaxis]
    late = np.concatenate([np.zeros((3, 1)), references[:-3]])
    outputs = late + 1e-3 * rng.standard_normal(late.shape)
    speeds = np.gradient(outputs, SPEC.sample_time_s, axis=0)
    states = np.full((SAMPLES, 1, 2), np.nan)
    seen = np.arange(SAMPLES) % 64 < 3
    states[seen] = np.stack([outputs, speeds], axis=2)[seen]
    return references, outputs, states


def one(seed: int = 0) -> UnreadTest:
    references, outputs, states = signals(seed)
    return unread_test(SPEC, NAMES, {"x": OMEGA_RAD_S}, references, outputs, states)


def read_at_once(folder: Path | None, *seeds: int) -> Memory:
    """A memory that has learned from each test after it."""
    memory = Memory(folder)
    for seed in seeds:
        references, outputs, states = signals(seed)
        step_s = SPEC.sample_time_s
        seen = state_evidence(NAMES, outputs[:, 0], states[:, 0], step_s, OMEGA_RAD_S)
        assert seen is not None
        learn(memory, SPEC, references, outputs, {"x": seen})
    return memory


def unread_in(folder: Path) -> list[Path]:
    return list(folder.glob("unread-*"))


@pytest.mark.parametrize("stored", [True, False])
def test_what_is_learned_later_is_what_would_have_been_learned_at_once(
    tmp_path: Path, stored: bool
) -> None:
    later = Memory(tmp_path / "later" if stored else None)
    for seed in range(3):
        later.keep_test(one(seed))
    at_once = read_at_once(None, 0, 1, 2)
    assert later.exported() == at_once.exported()
    assert later.states(SPEC, NAMES).gains == pytest.approx(at_once.states(SPEC, NAMES).gains)


def test_a_test_is_counted_before_it_is_learned_from_and_never_twice(tmp_path: Path) -> None:
    memory = Memory(tmp_path)
    for seed in range(2):
        memory.keep_test(one(seed))
    seconds = 2 * SAMPLES * SPEC.sample_time_s
    assert dict(memory.flown_s) == {"x": pytest.approx(seconds)}
    assert memory.own_model(SPEC).model is not None
    assert dict(memory.flown_s) == {"x": pytest.approx(seconds)}
    assert dict(Memory(tmp_path).flown_s) == {"x": pytest.approx(seconds)}
    assert unread_in(tmp_path) == []


def test_tests_survive_the_process(tmp_path: Path) -> None:
    for seed in range(3):
        Memory(tmp_path).keep_test(one(seed))
    assert Memory(tmp_path).exported() == read_at_once(None, 0, 1, 2).exported()


def test_a_test_that_was_not_written_to_its_end_is_cut_off(tmp_path: Path) -> None:
    for seed in range(2):
        Memory(tmp_path).keep_test(one(seed))
    (kept,) = unread_in(tmp_path)
    whole = kept.read_bytes()
    for torn in (whole[:-1], whole[: len(whole) // 2 + 10], whole[:-900] + bytes(900)):
        kept.write_bytes(torn)
        memory = Memory(tmp_path)
        assert dict(memory.flown_s) == {"x": pytest.approx(SAMPLES * SPEC.sample_time_s)}
        assert len(kept.read_bytes()) == len(whole) // 2
    memory.keep_test(one(1))
    assert memory.exported() == read_at_once(None, 0, 1).exported()


def test_an_agent_that_was_upgraded_starts_without_the_tests_of_its_earlier_version(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    Memory(tmp_path).keep_test(one())
    with monkeypatch.context() as upgraded:
        upgraded.setattr(codec, "PROTOCOL_VERSION", codec.PROTOCOL_VERSION + 1)
        upgraded.setattr(codec, "_parse_header", codec._parse_header.__wrapped__)  # no memory
        memory = Memory(tmp_path)
    assert "of another version of nufleet" in caplog.text
    assert memory.flown_s == {}
    assert memory.own_model(SPEC).model is None
    memory.keep_test(one())
    assert Memory(tmp_path).own_model(SPEC).model is not None


def test_tests_that_a_crash_left_beside_a_newer_model_are_not_learned_from_again(
    tmp_path: Path,
) -> None:
    memory = Memory(tmp_path)
    memory.keep_test(one())
    (kept,) = unread_in(tmp_path)
    data = kept.read_bytes()
    exported = memory.exported()
    kept.write_bytes(data)  # it was not removed in time
    assert Memory(tmp_path).exported() == exported
    assert unread_in(tmp_path) == []


def test_a_link_in_the_place_of_the_tests_is_removed_and_not_followed(tmp_path: Path) -> None:
    folder, elsewhere = tmp_path / "learned", tmp_path / "elsewhere"
    Memory(folder).keep_test(one())
    (kept,) = unread_in(folder)
    kept.rename(elsewhere)
    elsewhere.write_bytes(elsewhere.read_bytes() + b"more")
    data = elsewhere.read_bytes()
    kept.symlink_to(elsewhere)
    memory = Memory(folder)
    assert dict(memory.flown_s) == {}
    memory.keep_test(one(1))
    assert elsewhere.read_bytes() == data


def test_what_is_kept_has_a_bound(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unread, "UNREAD_BYTES_MAX", 40_000)
    memory = Memory(tmp_path)
    for seed in range(7):
        memory.keep_test(one(seed))
        assert sum(path.stat().st_size for path in unread_in(tmp_path)) <= 40_200
    assert dict(memory.flown_s) == {"x": pytest.approx(7 * SAMPLES * SPEC.sample_time_s)}
    assert memory.exported() == read_at_once(None, *range(7)).exported()


def test_forgetting_itself_forgets_its_tests(tmp_path: Path) -> None:
    memory = Memory(tmp_path)
    for _ in range(2):
        memory.keep_test(one())
        memory.forget_own_model()
        for known in (memory, Memory(tmp_path)):
            assert dict(known.flown_s) == {}
            assert known.own_model(SPEC).model is None


def test_a_test_costs_no_wait_for_the_disk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = Memory(tmp_path)
    memory.keep_test(one())  # which also makes the file
    waits: list[str] = []
    for kind in ("fsync", "fdatasync"):
        real = getattr(os, kind)
        monkeypatch.setattr(
            os, kind, lambda fd, kind=kind, real=real: (waits.append(kind), real(fd))
        )
    memory.keep_test(one(1))
    assert not waits


def test_a_full_disk_loses_the_test_alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    memory = Memory(tmp_path)
    memory.keep_test(one())

    def full(descriptor: int, data: bytes) -> None:
        os.write(descriptor, data[: len(data) // 2])
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(unread, "write_all", full)
        with pytest.raises(MemoryFolderError, match="No space left on device"):
            memory.keep_test(one(1))
    memory.keep_test(one(2))
    assert dict(Memory(tmp_path).flown_s) == dict(memory.flown_s)
    assert memory.exported() == read_at_once(None, 0, 2).exported()


def test_a_test_that_shows_nothing_is_left_out() -> None:
    memory = Memory(None)
    references, outputs, states = signals(0)
    memory.keep_test(
        unread_test(SPEC, NAMES, {"x": OMEGA_RAD_S}, references[:1], outputs[:1], states[:1])
    )
    memory.keep_test(one())
    assert memory.exported() == read_at_once(None, 0).exported()
