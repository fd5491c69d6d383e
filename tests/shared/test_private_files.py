"""A private file is written whole, through no link, and only its user can read it."""

from __future__ import annotations

import os
import stat
from pathlib import Path

import pytest

from nufleet.shared.private_files import make_private_folder, replace_privately, write_privately


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


def test_a_file_is_replaced_as_a_whole_and_readable_by_its_user_alone(tmp_path: Path) -> None:
    path = tmp_path / "baseline.learned"
    path.write_bytes(b"what was there before, and longer")
    path.chmod(0o644)
    write_privately(path, b"new")
    assert path.read_bytes() == b"new"
    assert mode(path) == 0o600
    assert list(tmp_path.iterdir()) == [path]


def test_a_link_in_the_place_of_the_part_is_removed_and_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"somebody's")
    path = tmp_path / "prior.learned"
    path.with_name("prior.learned.part").symlink_to(victim)
    write_privately(path, b"ours")
    assert victim.read_bytes() == b"somebody's"
    assert path.read_bytes() == b"ours"
    assert not path.is_symlink()


def test_a_link_in_the_place_of_the_file_is_replaced_and_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"somebody's")
    path = tmp_path / "prior.learned"
    path.symlink_to(victim)
    write_privately(path, b"ours")
    assert victim.read_bytes() == b"somebody's"
    assert not path.is_symlink()


def test_what_was_there_stays_when_the_disk_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "prior.learned"
    write_privately(path, b"old")

    def full(*_: object) -> int:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "write", full)
    with pytest.raises(OSError, match="No space left"):
        write_privately(path, b"new")
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_the_descriptor_of_a_file_that_was_replaced_appends_to_it(tmp_path: Path) -> None:
    path = tmp_path / "log"
    descriptor = replace_privately(path, b"head", tmp_path / "log.new")
    os.write(descriptor, b" and more")
    os.close(descriptor)
    assert path.read_bytes() == b"head and more"


def test_a_private_folder_is_nobody_elses_nor_are_those_made_above_it(tmp_path: Path) -> None:
    there = tmp_path / "there"
    there.mkdir(mode=0o755)
    folder = there / "fleet" / "robot"
    make_private_folder(folder)
    assert (mode(there), mode(folder.parent), mode(folder)) == (0o755, 0o700, 0o700)


def test_a_folder_that_others_could_look_into_is_closed_to_them(tmp_path: Path) -> None:
    folder = tmp_path / "learned"
    folder.mkdir(mode=0o755)
    make_private_folder(folder)
    assert mode(folder) == 0o700
