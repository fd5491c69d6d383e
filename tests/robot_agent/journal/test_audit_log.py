"""An audit log keeps what was asked, in a chain that shows every change."""

from __future__ import annotations

import stat
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest
from click.testing import CliRunner

from nufleet.robot_agent.journal.audit_command import show, verify
from nufleet.robot_agent.journal.audit_log import AUDIT_LOG, AuditLog, read_audit_log, verified
from nufleet.robot_agent.journal.ledger import JournalError


@contextmanager
def opened(folder: Path) -> Iterator[AuditLog]:
    with ThreadPoolExecutor(4) as clerks:
        log = AuditLog(folder, clerks)
        yield log
        log.close()


def written(folder: Path, *goals: str) -> Path:
    with opened(folder) as log:
        for goal in goals:
            log.record("desk", "desk.host-1", "goal", goal, "done", epoch=3)
    return folder / AUDIT_LOG


def test_entries_are_kept_in_their_order_across_agents(tmp_path: Path) -> None:
    written(tmp_path, "g1", "g2")
    path = written(tmp_path, "g3")
    entries = list(read_audit_log(path))
    assert [entry.about for entry in entries] == ["g1", "g2", "g3"]
    assert {(entry.principal, entry.sender, entry.epoch) for entry in entries} == {
        ("desk", "desk.host-1", 3)
    }
    assert (verified(path).entries, verified(path).broken) == (3, None)
    assert stat.S_IMODE(path.stat().st_mode) == 0o600


@pytest.mark.parametrize(
    ("damage", "intact"),
    [
        (lambda lines: [lines[0], lines[1].replace("g2", "gX"), *lines[2:]], 2),
        (lambda lines: [lines[0], *lines[2:]], 1),
        (lambda lines: [lines[0], lines[0], *lines[1:]], 1),
        (lambda lines: [lines[1], lines[0], *lines[2:]], 0),
        (lambda lines: [lines[0], "{}", *lines[1:]], 1),
        (lambda lines: lines[1:], 0),
    ],
    ids=["changed", "removed", "repeated", "exchanged", "inserted", "beginning cut off"],
)
def test_a_change_breaks_the_chain(
    damage: Callable[[list[str]], list[str]], intact: int, tmp_path: Path
) -> None:
    path = written(tmp_path, "g1", "g2", "g3", "g4")
    path.write_text("\n".join(damage(path.read_text().splitlines())) + "\n")
    found = verified(path)
    assert found.broken is not None
    assert found.entries == intact


def test_an_end_that_was_cut_off_shows_by_a_digest_noted_before(tmp_path: Path) -> None:
    path = written(tmp_path, "g1", "g2", "g3")
    noted = verified(path).digest
    assert verified(written(tmp_path, "g4"), digest=noted).broken is None
    path.write_text("\n".join(path.read_text().splitlines()[:2]) + "\n")
    assert verified(path).broken is None
    broken = verified(path, digest=noted).broken
    assert broken is not None
    assert noted in broken


def test_a_line_that_lost_its_end_with_the_power_is_removed(tmp_path: Path) -> None:
    path = written(tmp_path, "g1", "g2")
    with path.open("a") as file:
        file.write('{"time":"2026')
    assert verified(path).broken is None
    written(tmp_path, "g3")
    assert [entry.about for entry in read_audit_log(path)] == ["g1", "g2", "g3"]
    assert verified(path).broken is None


def test_texts_from_the_network_control_no_terminal_and_take_no_more_than_a_line(
    tmp_path: Path,
) -> None:
    with opened(tmp_path) as log:
        log.record(None, "x" * 5000, "stop", "\x1b[31mred\n" + "ö" * 5000, "stopped")
        log.close()
    (entry,) = read_audit_log(tmp_path / AUDIT_LOG)
    assert "\x1b" not in entry.about
    assert len((tmp_path / AUDIT_LOG).read_bytes()) < 4096
    assert written(tmp_path, "g").stat().st_size > 0
    assert verified(tmp_path / AUDIT_LOG).entries == 2


def test_the_commands_show_and_check_a_log(tmp_path: Path) -> None:
    path = written(tmp_path, "g1", "g2")
    shown = CliRunner().invoke(show, [str(tmp_path)])
    assert shown.output.count("desk (desk.host-1) asked goal") == 2
    assert CliRunner().invoke(show, [str(path), "--principal", "anna"].copy()).output == ""
    assert CliRunner().invoke(verify, [str(tmp_path)]).exit_code == 0
    path.write_text(path.read_text().replace("g1", "g9"))
    failed = CliRunner().invoke(verify, [str(tmp_path)])
    assert failed.exit_code == 1
    assert "NOT WHOLE: line 2 does not follow" in failed.output


def test_a_log_that_is_a_link_is_not_followed_and_named(tmp_path: Path) -> None:
    (tmp_path / "elsewhere").touch()
    (tmp_path / AUDIT_LOG).symlink_to(tmp_path / "elsewhere")
    many = f"{AUDIT_LOG}: Too many levels of symbolic links"
    with pytest.raises(JournalError, match=many), opened(tmp_path):
        pass


def test_the_digest_of_a_log_that_was_empty_is_met_by_whatever_followed(tmp_path: Path) -> None:
    written(tmp_path)
    noted = verified(tmp_path / AUDIT_LOG).digest
    assert verified(written(tmp_path, "g1"), digest=noted).broken is None


def test_entries_of_many_threads_follow_from_each_other_and_none_is_taken_after_the_end(
    tmp_path: Path,
) -> None:
    with opened(tmp_path) as log, ThreadPoolExecutor(8) as pool:
        asked = [str(k) for k in range(400)]
        list(pool.map(lambda goal: log.record("d", "d.1", "goal", goal, "done"), asked))
        log.close()
        log.record("d", "d.1", "goal", "late", "done")
    path = tmp_path / AUDIT_LOG
    assert sorted(entry.about for entry in read_audit_log(path)) == sorted(asked)
    assert verified(path).broken is None
