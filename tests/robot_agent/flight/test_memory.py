"""What a robot learned is there again after a restart, whole or not at all."""

from __future__ import annotations

import os
import threading
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from learned_things import experience, flown_before
from robots_that_learn import double_integrator

from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.robot_agent.flight.memory import PRIOR, Memory, MemoryFolderError
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.file import decode_experience, digest
from nufleet.shared.wire.motions import MIXTURE_MAX

OWN = experience("target", "preview")
GIVEN = experience("source", "state", seed=1)
SPEC = double_integrator().spec
MOTION = flown_before(SPEC)


def filled(folder: Path) -> Memory:
    """A memory with an experience, a prior and a baseline."""
    memory = Memory(folder)
    memory.keep_experience(OWN, digest(OWN))
    memory.keep_prior(GIVEN, digest(GIVEN))
    memory.learn(MOTION)
    return memory


def test_a_new_memory_is_empty(tmp_path: Path) -> None:
    for memory in (Memory(tmp_path / "new" / "learned"), Memory(None)):
        assert memory.experiences == ()
        assert memory.prior is None
        assert dict(memory.flown_s) == {}
        assert memory.find(digest(OWN)) is None


def test_all_that_was_learned_survives_a_restart(tmp_path: Path) -> None:
    filled(tmp_path)
    again = Memory(tmp_path)
    assert [kept.payload for kept in again.experiences] == [OWN]
    assert again.prior is not None
    assert (again.prior.payload, again.prior.sha256) == (GIVEN, digest(GIVEN))
    assert dict(again.flown_s) == {"x": pytest.approx(9.0)}


def test_what_was_kept_computes_what_its_file_says(tmp_path: Path) -> None:
    filled(tmp_path)
    prior = Memory(tmp_path).prior
    assert prior is not None
    inputs = np.random.default_rng(2).standard_normal((5, len(prior.manifest.inputs)))
    expected = NetworkInverse(decode_experience(GIVEN))(inputs)
    np.testing.assert_array_equal(prior.inverse(inputs), expected)


def test_without_a_folder_nothing_survives_and_all_else_works(tmp_path: Path) -> None:
    memory = Memory(None)
    memory.keep_prior(GIVEN, digest(GIVEN))
    memory.learn(MOTION)
    assert memory.prior is not None
    memory.forget_prior()
    assert memory.prior is None


def test_there_is_one_experience_for_each_architecture_and_the_last_counts(tmp_path: Path) -> None:
    memory = filled(tmp_path)
    state = experience("target", "state", seed=3)
    newer = experience("target", "preview", seed=4)
    memory.keep_experience(newer, digest(newer))
    memory.keep_experience(state, digest(state))
    for known in (memory, Memory(tmp_path)):
        assert [kept.payload for kept in known.experiences] == [state, newer]
        assert known.find(digest(OWN)) is None
        found = known.find(digest(newer))
        assert found is not None
        assert found.payload == newer


def test_a_prior_that_is_forgotten_stays_forgotten(tmp_path: Path) -> None:
    memory = filled(tmp_path)
    memory.forget_prior()
    memory.forget_prior()
    assert memory.prior is None
    again = Memory(tmp_path)
    assert again.prior is None
    assert len(again.experiences) == 1


def payloads(memory: Memory) -> list[bytes]:
    return [prior.payload for prior in memory.priors]


def test_priors_beside_each_other_keep_their_order_over_a_restart(tmp_path: Path) -> None:
    memory = filled(tmp_path)
    others = [experience(f"source-{i}", "state", seed=i) for i in range(2, MIXTURE_MAX + 1)]
    for payload in others:
        memory.keep_prior(payload, digest(payload), beside=True)
    for known in (memory, Memory(tmp_path)):
        assert payloads(known) == [GIVEN, *others]
        assert known.prior is not None
        assert known.prior.payload == GIVEN
    one_more = experience("late", "state", seed=50)
    with pytest.raises(MemoryFolderError, match=f"it holds {MIXTURE_MAX} priors"):
        memory.keep_prior(one_more, digest(one_more), beside=True)
    # By itself it takes the place of all.
    memory.keep_prior(one_more, digest(one_more))
    for known in (memory, Memory(tmp_path)):
        assert payloads(known) == [one_more]


def test_a_crash_while_one_prior_replaces_several_never_mixes_old_and_new(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = filled(tmp_path)
    other, newer = experience("other", "state", seed=5), experience("newer", "state", seed=6)
    memory.keep_prior(other, digest(other), beside=True)

    def crash(*_: object) -> None:
        raise CrashError

    with monkeypatch.context() as patched:
        patched.setattr(Path, "replace", crash)
        with pytest.raises(CrashError):
            memory.keep_prior(newer, digest(newer))
    assert payloads(Memory(tmp_path)) == [GIVEN]
    memory = Memory(tmp_path)
    memory.keep_prior(other, digest(other), beside=True)
    unlink = Path.unlink

    def crash_at_others(path: Path, missing_ok: bool = False) -> None:
        if path.name.startswith(f"{PRIOR}-") and path.suffix == ".learned":
            raise CrashError
        unlink(path, missing_ok)

    with monkeypatch.context() as patched:
        patched.setattr(Path, "unlink", crash_at_others)
        with pytest.raises(CrashError):
            memory.keep_prior(newer, digest(newer))
    assert payloads(Memory(tmp_path)) == [GIVEN, other]


def test_a_newer_experience_of_a_source_takes_the_place_of_its_earlier_one(tmp_path: Path) -> None:
    memory = filled(tmp_path)
    other, newer = experience("other", "state", seed=5), experience("source", "state", seed=6)
    for payload in (other, newer):
        memory.keep_prior(payload, digest(payload), beside=True)
    for known in (memory, Memory(tmp_path)):
        assert payloads(known) == [newer, other]
    memory.forget_prior()
    assert payloads(Memory(tmp_path)) == []


@pytest.mark.parametrize(
    ("payload", "sha256"),
    [(GIVEN[:-3], digest(GIVEN)), (b"PK\x03\x04" + bytes(100), None), (GIVEN, "0" * 64)],
)
def test_what_is_no_experience_is_not_kept_and_the_prior_before_it_stays(
    tmp_path: Path, payload: bytes, sha256: str | None
) -> None:
    memory = filled(tmp_path)
    with pytest.raises(MalformedMessageError):
        memory.keep_prior(payload, sha256 or digest(payload))
    for known in (memory, Memory(tmp_path)):
        assert known.prior is not None
        assert known.prior.payload == GIVEN


# What may happen to the files.


@pytest.mark.parametrize("name", ["preview", PRIOR, "own"])
@pytest.mark.parametrize("damage", ["truncated", "altered", "empty", "another file"])
def test_a_damaged_file_is_refused_with_its_name_and_what_to_do(
    tmp_path: Path, name: str, damage: str
) -> None:
    filled(tmp_path)
    (path,) = tmp_path.glob(f"{name}.*")
    good = path.read_bytes()
    path.write_bytes(
        {
            "truncated": good[:-1],
            "altered": good[:-5] + bytes([good[-5] ^ 1]) + good[-4:],
            "empty": b"",
            "another file": b"PK\x03\x04" + bytes(1000),
        }[damage]
    )
    with pytest.raises(MemoryFolderError, match=r"is damaged.*remove it") as raised:
        Memory(tmp_path)
    assert str(path) in str(raised.value)
    path.unlink()
    assert len(Memory(tmp_path).experiences) == (0 if name == "preview" else 1)


@settings(max_examples=20, deadline=None)
@given(st.data())
def test_no_changed_byte_of_a_model_goes_unnoticed(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    folder = tmp_path_factory.mktemp("memory")
    filled(folder)
    (path,) = folder.glob(f"{PRIOR}.*")
    stored = bytearray(path.read_bytes())
    stored[data.draw(st.integers(0, len(stored) - 1))] ^= data.draw(st.integers(1, 255))
    path.write_bytes(stored)
    with pytest.raises(MemoryFolderError):
        Memory(folder)


def test_a_file_of_another_version_is_refused_although_it_is_whole(tmp_path: Path) -> None:
    filled(tmp_path)
    (path,) = tmp_path.glob("own.*")
    other = b'{"x": {"settled": null, "new": {"squares": "small"}}}'
    path.write_bytes(bytes.fromhex(digest(other)) + other)
    with pytest.raises(MemoryFolderError, match=r"squares.*remove it"):
        Memory(tmp_path)
    other = OWN.replace(b'"schema_version', b'"schema_vorsion')
    path.unlink()
    (tmp_path / f"{PRIOR}.learned").write_bytes(bytes.fromhex(digest(other)) + other)
    with pytest.raises(MemoryFolderError, match="train or transfer again"):
        Memory(tmp_path)


def test_a_folder_that_cannot_be_made_is_answered_by_the_variable_that_names_another(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(MemoryFolderError, match="choose a writable folder with NUFLEET_STATE"):
        Memory(tmp_path / "file" / "learned")


class CrashError(Exception):
    """The process ended here."""


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_crash_while_it_writes_leaves_the_old_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: str
) -> None:
    memory = filled(tmp_path)

    def crash(*_: object) -> None:
        raise CrashError

    with monkeypatch.context() as patched:
        if step == "fsync":
            patched.setattr(os, "fsync", crash)
        else:
            patched.setattr(Path, "replace", crash)
        newer = experience("other", "state", seed=9)
        with pytest.raises(CrashError):
            memory.keep_prior(newer, digest(newer))
    again = Memory(tmp_path)
    assert again.prior is not None
    assert again.prior.payload == GIVEN
    # What the crash left does not stand in the way of the next attempt.
    again.keep_prior(newer, digest(newer))
    last = Memory(tmp_path).prior
    assert last is not None
    assert last.payload == newer
    assert not list(tmp_path.glob("*.part"))


def test_a_disk_that_cannot_be_written_leaves_what_was_known(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    memory = filled(tmp_path)

    def full(*_: object) -> None:
        raise OSError(28, "No space left on device")

    newer = experience("other", "state", seed=9)
    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", full)
        with pytest.raises(MemoryFolderError, match=r"prior.*No space left on device"):
            memory.keep_prior(newer, digest(newer))
        with pytest.raises(MemoryFolderError, match=r"own.*No space left on device"):
            memory.learn({})
    for known in (memory, Memory(tmp_path)):
        assert known.prior is not None
        assert known.prior.payload == GIVEN
        assert dict(known.flown_s) == {"x": pytest.approx(9.0)}


def test_a_folder_that_cannot_be_made_is_an_error_that_names_it(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    with pytest.raises(MemoryFolderError, match="file/learned"):
        Memory(tmp_path / "file" / "learned")


def test_readers_see_whole_experiences_while_others_are_kept(tmp_path: Path) -> None:
    memory = Memory(tmp_path)
    files = [experience("source", "state", seed=seed) for seed in range(4)]
    ended = threading.Event()
    seen: list[bool] = []

    def read() -> None:
        while not ended.is_set():
            prior = memory.prior
            if prior is not None:
                seen.append(digest(prior.payload) == prior.sha256)

    reader = threading.Thread(target=read)
    reader.start()
    try:
        for payload in files * 3:
            memory.keep_prior(payload, digest(payload))
    finally:
        ended.set()
        reader.join()
    assert all(seen)
    again = Memory(tmp_path).prior
    assert again is not None
    assert again.payload == files[-1]


def test_a_link_where_a_file_would_be_written_first_leads_nowhere(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"somebody's")
    folder = tmp_path / "learned"
    memory = Memory(folder)
    for name in ("prior.part", "prior.learned.part"):
        (folder / name).symlink_to(victim)
    memory.keep_prior(GIVEN, digest(GIVEN))
    assert victim.read_bytes() == b"somebody's"
    assert Memory(folder).prior is not None


def test_what_a_robot_learned_is_its_users_alone(tmp_path: Path) -> None:
    folder = tmp_path / "learned"
    folder.mkdir(mode=0o755)
    filled(folder)
    assert folder.stat().st_mode & 0o077 == 0
    assert all(path.stat().st_mode & 0o077 == 0 for path in folder.iterdir())
