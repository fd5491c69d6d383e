"""A robot's journal on a real disk: reopened, cut, altered, killed, full, and opened twice."""

from __future__ import annotations

import contextlib
import errno
import os
import random
import shutil
import stat
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest
from journal_facts import DIGEST, PLAN, content, goal, result, write
from polling import PATIENCE_S

from nufleet.robot_agent.journal.frames import scan
from nufleet.robot_agent.journal.journal import DAMAGED_LOG, LOG, Journal, JournalInUseError
from nufleet.robot_agent.journal.ledger import JournalError, Ledger, Owned, decode_record
from nufleet.robot_agent.rules.goal_machine import Accepted, recognise
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.wire.messages import Outcome, Refusal
from nufleet.shared.wire.motions import FlightPlan

ROOT = Path(__file__).parents[3]
HISTORY: tuple[tuple[Any, ...], ...] = (
    ("own", "orchestrator-1", 3),
    ("accept", "g1"),
    ("end", "g1", Outcome.COMPLETED),
    ("accept", "g2"),
    ("stop", "alice"),
    ("end", "g2", Outcome.ABORTED),
    ("acknowledge", "g1"),
    ("release", "bob"),
    ("own", "orchestrator-2", 4),
    ("forgo", "g4"),
    ("accept", "g3"),
)

STOPPED_AFTER = {
    "nothing": {False},
    "accepted": {False, True},  # the stop that comes next may be stored and not said
    "stopped": {True},
    "ended": {True, False},
    "released": {False},
}


def ledger_in(data: bytes) -> Ledger:
    ledger = Ledger()
    for payload in scan(data).payloads:
        ledger.apply(decode_record(payload))
    return ledger


def test_a_new_journal_remembers_nothing(tmp_path: Path) -> None:
    with Journal(tmp_path / "of" / "r1") as journal:
        found = journal.remembrance
    assert (dict(found.goals.known), found.goals.running) == ({}, None)
    assert (found.stop, found.owner, found.lost, found.damage) == (None, None, (), None)


def test_a_test_of_a_robot_waits_for_the_disk_three_times(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    flushed: list[str] = []
    for kind in ("fsync", "fdatasync"):
        real = getattr(os, kind)
        monkeypatch.setattr(
            os, kind, lambda fd, kind=kind, real=real: (flushed.append(kind), real(fd))
        )
    with Journal(tmp_path) as journal:
        for n in range(3):
            flushed.clear()
            write(journal, ("accept", f"g{n + 1}"))
            assert flushed == ["fdatasync"], "what was acknowledged is on disk with the next goal"
            write(journal, ("end", f"g{n + 1}", Outcome.COMPLETED))
            write(journal, ("acknowledge", f"g{n + 1}"))
    # The bytes of the result, which are written over those of an earlier one, and the record that
    # it belongs to.
    assert flushed == ["fdatasync"] * 3


def test_a_new_process_knows_what_the_one_before_was_told(tmp_path: Path) -> None:
    with Journal(tmp_path) as journal:
        for fact in (*HISTORY, ("stop", "carol"), ("stop", "dave")):
            write(journal, fact)
    with Journal(tmp_path) as journal:
        found = journal.remembrance
        assert found.stop == StopOrder("carol", "look out")
        assert found.owner is not None
        assert (found.owner.owner, found.owner.epoch) == ("orchestrator-2", 4)
        outcomes = {goal_id: known.outcome for goal_id, known in found.goals.known.items()}
        assert outcomes == {
            "g1": Outcome.COMPLETED,
            "g2": Outcome.ABORTED,
            "g4": Outcome.CANCELLED,
            "g3": Outcome.LOST,
        }
        kept, sent = journal.result("g2"), result("g2", outcome=Outcome.ABORTED)
        assert kept is not None
        assert kept.response.tobytes() == sent.response.tobytes()
        assert journal.result("g1") is None, "it was acknowledged"
        assert journal.result("g9") is None


def test_a_goal_in_progress_is_lost_and_never_moves_again_under_its_id(tmp_path: Path) -> None:
    with Journal(tmp_path) as journal:
        journal.accepted(goal("g1"), PLAN, "boot-1")
    for time_opened in range(3):
        with Journal(tmp_path) as journal:
            assert journal.remembrance.lost == (("g1",) if time_opened == 0 else ())
            goals = journal.remembrance.goals
            assert goals.running is None
            again = recognise(goals, goal_id="g1", digest=DIGEST)
            assert isinstance(again, Accepted)
            assert not again.new
            assert isinstance(recognise(goals, goal_id="g1", digest="other"), Refusal)
            lost = journal.result("g1")
            assert lost is not None
            assert (lost.outcome, lost.boot_id, len(lost.response)) == (
                Outcome.LOST,
                "boot-1",
                0,
            )
            assert "boot-1" in lost.reason


def test_a_goal_that_was_cancelled_before_it_came_moves_nothing_in_any_later_life(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Journal(tmp_path) as journal:
        journal.forgone("g1")
    monkeypatch.setattr("nufleet.robot_agent.journal.journal.COMPACT_ABOVE_BYTES", 100)
    for _ in range(3):
        with Journal(tmp_path) as journal:
            refusal = recognise(journal.remembrance.goals, goal_id="g1", digest=DIGEST)
            assert isinstance(refusal, Refusal)
            assert refusal.code == "cancelled"
            assert (journal.remembrance.lost, journal.result("g1")) == ((), None)
            journal.owned("orchestrator-1", 3)  # and the log is rewritten
            journal.owned("orchestrator-1", 4)


def test_one_that_is_cancelled_again_is_stored_once(tmp_path: Path) -> None:
    with Journal(tmp_path) as journal:
        journal.forgone("g1")
        size_bytes = (tmp_path / LOG).stat().st_size
        for _ in range(100):
            journal.forgone("g1")
        assert (tmp_path / LOG).stat().st_size == size_bytes


def test_cut_at_any_byte_the_next_process_knows_exactly_what_was_written_before(
    tmp_path: Path,
) -> None:
    # After each fact, what was on disk; then every length that a crash may have left.
    lengths, facts = [], []
    with Journal(tmp_path / "whole") as journal:
        for fact in HISTORY:
            lengths.append((tmp_path / "whole" / LOG).stat().st_size)
            facts.append(content(ledger_in((tmp_path / "whole" / LOG).read_bytes())))
            write(journal, fact)
        data = (tmp_path / "whole" / LOG).read_bytes()
    lengths.append(len(data))
    facts.append(content(ledger_in(data)))
    for end in range(lengths[0], len(data) + 1):
        found = scan(data[:end])
        assert found.damage is None
        known = max(n for n, length in enumerate(lengths) if length <= end)
        assert content(ledger_in(data[:end])) == facts[known]
    for end in [*lengths, *(length + 9 for length in lengths[:-1])]:
        folder = tmp_path / f"cut-{end}"
        shutil.copytree(tmp_path / "whole", folder)
        os.truncate(folder / LOG, end)
        known = max(n for n, length in enumerate(lengths) if length <= end)
        goals, _, stop, owner = facts[known]
        running = tuple(key for key, value in goals.items() if value.goal.outcome is None)
        with Journal(folder) as journal:
            found_now = journal.remembrance
            assert (found_now.stop, found_now.owner, found_now.lost) == (stop, owner, running)
            assert found_now.damage is None
            journal.stopped(StopOrder("after", "the crash"))
        with Journal(folder) as journal:
            assert journal.remembrance.stop == (stop or StopOrder("after", "the crash"))
            assert journal.remembrance.damage is None


@pytest.mark.parametrize("share", [0.0, 0.3, 0.6, 0.99])
def test_an_altered_journal_leaves_the_robot_stopped_with_what_can_be_saved(
    tmp_path: Path, share: float
) -> None:
    with Journal(tmp_path) as journal:
        for fact in HISTORY:
            write(journal, fact)
    data = bytearray((tmp_path / LOG).read_bytes())
    data[int(share * len(data))] ^= 0x10
    (tmp_path / LOG).write_bytes(data)
    with Journal(tmp_path) as journal:
        found = journal.remembrance
        assert found.damage is not None
        assert found.stop is not None
        assert (tmp_path / DAMAGED_LOG).read_bytes() == data
        assert set(found.goals.known) <= {"g1", "g2", "g3", "g4"}
    with Journal(tmp_path) as journal:
        assert journal.remembrance.damage is None
        assert journal.remembrance.stop is not None, "only a release ends it"
        assert journal.remembrance.goals.known == found.goals.known
        journal.released("bob")
    with Journal(tmp_path) as journal:
        assert journal.remembrance.stop is None


def test_a_result_whose_file_was_altered_is_not_given_out(tmp_path: Path) -> None:
    with Journal(tmp_path) as journal:
        journal.accepted(goal("g1"), PLAN, "boot-1")
        assert journal.ended(result("g1"))
        (path,) = (tmp_path / "results").iterdir()
        data = path.read_bytes()
        for altered in (data[:-1], data[:-1] + bytes([data[-1] ^ 1]), b""):
            path.write_bytes(altered)
            assert journal.result("g1") is None
        path.unlink()
        assert journal.result("g1") is None
    with Journal(tmp_path) as journal:
        assert journal.remembrance.goals.known["g1"].outcome is Outcome.COMPLETED


def test_results_are_written_over_what_is_no_longer_needed_and_over_nothing_else(
    tmp_path: Path,
) -> None:
    with Journal(tmp_path) as journal:
        for n in range(6):
            write(journal, ("accept", f"g{n}"))
            write(journal, ("end", f"g{n}", Outcome.COMPLETED))
            if n % 2:
                write(journal, ("acknowledge", f"g{n}"))
        assert len(list((tmp_path / "results").iterdir())) == 4
    with Journal(tmp_path) as journal:
        for n in range(6):
            kept = journal.result(f"g{n}")
            assert (kept is None) == bool(n % 2)
            assert kept is None or kept.goal_id == f"g{n}"
        assert len(list((tmp_path / "results").iterdir())) == 3, "the spare one is not needed"
        write(journal, ("accept", "g9"))
        write(journal, ("end", "g9", Outcome.COMPLETED))
        assert all(journal.result(f"g{n}") is not None for n in (0, 2, 4, 9))


def test_a_large_result_that_is_no_longer_needed_does_not_fill_the_disk(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nufleet.robot_agent.journal.result_files.SPARE_BYTES_MAX", 10)
    with Journal(tmp_path) as journal:
        write(journal, ("accept", "g1"))
        write(journal, ("end", "g1", Outcome.COMPLETED))
        write(journal, ("acknowledge", "g1"))
        assert list((tmp_path / "results").iterdir()) == []


def test_results_of_an_earlier_version_are_found_under_the_names_of_their_goals(
    tmp_path: Path,
) -> None:
    with Journal(tmp_path) as journal:
        write(journal, ("accept", "g1"))
        write(journal, ("end", "g1", Outcome.COMPLETED))
    (path,) = (tmp_path / "results").iterdir()
    path.rename(path.with_name("g1"))
    with Journal(tmp_path) as journal:
        assert journal.result("g1") is not None


def test_a_journal_of_a_newer_nufleet_is_left_alone(tmp_path: Path) -> None:
    from nufleet.robot_agent.journal.frames import encode_frame, file_head

    Journal(tmp_path).close()
    salt = bytes(16)
    data = file_head(salt) + encode_frame(salt, 1, b'{"kind": "flown to the moon"}')
    (tmp_path / LOG).write_bytes(data)
    with pytest.raises(JournalError, match="a different version of nufleet"):
        Journal(tmp_path)
    assert (tmp_path / LOG).read_bytes() == data


def test_two_agents_of_one_robot_are_noticed(tmp_path: Path) -> None:
    with Journal(tmp_path), pytest.raises(JournalInUseError, match="another agent"):
        Journal(tmp_path)
    Journal(tmp_path).close()


def test_its_size_is_bounded_however_long_it_is_used(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nufleet.robot_agent.journal.ledger.REMEMBERED_GOALS", 50)
    monkeypatch.setattr("nufleet.robot_agent.journal.journal.COMPACT_ABOVE_BYTES", 16_000)
    largest = 0
    with Journal(tmp_path) as journal:
        for n in range(150):
            journal.accepted(goal(f"g{n}"), PLAN, "boot-1")
            journal.ended(result(f"g{n}"))
            journal.stopped(StopOrder("a", "b"))
            journal.released("a")
            largest = max(largest, (tmp_path / LOG).stat().st_size)
        assert len(list((tmp_path / "results").iterdir())) <= 32 + 1  # and one to write over
    assert largest < 40_000
    with Journal(tmp_path) as journal:
        assert list(journal.remembrance.goals.known) == [f"g{n}" for n in range(100, 150)]
        assert journal.result("g149") is not None
        assert journal.result("g100") is None


def test_what_crashes_left_lying_about_is_swept_away(tmp_path: Path) -> None:
    Journal(tmp_path).close()
    for place in ("results/never-ended", "incoming/g1.result", "incoming/log.new"):
        (tmp_path / place).write_bytes(b"half")
    Journal(tmp_path).close()
    assert not list((tmp_path / "results").iterdir())
    assert not list((tmp_path / "incoming").iterdir())


def test_many_threads_write_and_nothing_is_torn(tmp_path: Path) -> None:
    together = threading.Barrier(4, timeout=PATIENCE_S)

    def work(worker: int) -> None:
        together.wait()
        for n in range(10):
            journal.accepted(goal(f"w{worker}-{n}"), PLAN, "boot-1")
            journal.ended(result(f"w{worker}-{n}"))

    with Journal(tmp_path) as journal, ThreadPoolExecutor(4) as pool:
        list(pool.map(work, range(4)))
    with Journal(tmp_path) as journal:
        assert len(journal.remembrance.goals.known) == 40
        assert (journal.remembrance.damage, journal.remembrance.lost) == (None, ())


def start(script: str, *arguments: Any) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, Path(__file__).with_name(script), *map(str, arguments)],
        stdout=subprocess.PIPE,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )


def test_a_process_killed_while_it_writes_loses_nothing_that_it_was_told_is_stored(
    tmp_path: Path,
) -> None:
    rng = random.Random(5)
    told: set[str] = set()
    ended: set[str] = set()
    for life in range(4):
        # It says each thing once the journal has stored it: what an orchestrator would have heard.
        with start("journal_writer.py", tmp_path, life) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == "open\n"
            said = [process.stdout.readline()[:-1] for _ in range(rng.randrange(1, 40))]
            time.sleep(rng.uniform(0.0, 0.005))
            process.kill()
            said += process.stdout.read().split("\n")[:-1]
        stored = [line.split() for line in said]
        accepted = [goal_id for what, goal_id in stored if what == "accepted"]
        told |= set(accepted)
        ended |= {goal_id for what, goal_id in stored if what == "ended"}
        with Journal(tmp_path) as journal:
            found = journal.remembrance
            assert found.damage is None
            assert told <= set(found.goals.known)
            assert len(set(found.goals.known) - told) <= life + 1, "one may be stored and not said"
            for goal_id, known in found.goals.known.items():
                assert known.outcome is not None
                assert goal_id not in ended or known.outcome is Outcome.COMPLETED
            assert len(found.lost) <= 1
            assert set(found.lost).isdisjoint(ended)
            last = stored[-1][0] if stored else "nothing"
            assert (found.stop is not None) in STOPPED_AFTER[last]
            journal.released("test")
    assert len(told) > 10


def failing(*_: object) -> None:
    raise OSError(errno.EIO, "Input/output error")


def test_after_a_disk_error_that_leaves_doubt_nothing_is_stored_any_more(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Journal(tmp_path) as journal:
        journal.accepted(goal("g1"), PLAN, "boot-1")
        with monkeypatch.context() as broken:
            broken.setattr("os.fdatasync", failing)
            with pytest.raises(JournalError, match="the disk failed"):
                journal.accepted(goal("g2"), PLAN, "boot-1")
        with pytest.raises(JournalError, match="restart the agent"):
            journal.accepted(goal("g3"), PLAN, "boot-1")
    with Journal(tmp_path) as journal:
        assert journal.remembrance.damage is None
        assert {"g1"} <= set(journal.remembrance.goals.known) <= {"g1", "g2"}


def test_a_log_that_cannot_be_shortened_is_used_as_it_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nufleet.robot_agent.journal.journal.COMPACT_ABOVE_BYTES", 100)
    with Journal(tmp_path) as journal:
        with monkeypatch.context() as broken:
            broken.setattr("os.fsync", failing)
            journal.accepted(goal("g1"), PLAN, "boot-1")
        journal.stopped(StopOrder("a", "b"))
    with Journal(tmp_path) as journal:
        assert journal.remembrance.lost == ("g1",)
        assert journal.remembrance.stop == StopOrder("a", "b")


def test_what_is_written_to_a_log_that_was_replaced_is_not_called_stored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("nufleet.robot_agent.journal.journal.COMPACT_ABOVE_BYTES", 100)
    calls: list[int] = []
    fsync = os.fsync

    def fail_second(descriptor: int) -> None:
        calls.append(descriptor)
        if len(calls) == 2:  # the folder's, after the new log is in its place
            failing()
        fsync(descriptor)

    with Journal(tmp_path) as journal:
        with monkeypatch.context() as broken:
            broken.setattr("os.fsync", fail_second)
            journal.accepted(goal("g1"), PLAN, "boot-1")
        with pytest.raises(JournalError, match="it was replaced"):
            journal.stopped(StopOrder("a", "b"))
    with Journal(tmp_path) as journal:
        assert journal.remembrance.lost == ("g1",)


def test_a_full_disk_takes_no_goal_and_heals(tmp_path: Path) -> None:
    mount = 'mount -t tmpfs -o size=1m small "$1" && exec "$2" "$3" "$1"'
    script = Path(__file__).with_name("journal_disk_trouble.py")
    apart = ["unshare", "--mount", "--user", "--map-root-user", "sh", "-c", mount, "sh"]
    done = subprocess.run(
        [*apart, tmp_path, sys.executable, script],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    assert "No space left on device" in done.stdout


def test_a_flight_in_progress_is_lost_as_a_test_is(tmp_path: Path) -> None:
    plan = FlightPlan(sample_time_s=0.02, samples=100, duration_s=4.0)
    with Journal(tmp_path) as journal:
        journal.accepted(goal("g1"), plan, "boot-1")
    with Journal(tmp_path) as journal:
        lost = journal.result("g1")
        assert lost is not None
        assert (lost.outcome, lost.plan, lost.response.size) == (Outcome.LOST, plan, 0)


def test_an_owner_that_is_forgotten_is_unknown_to_the_next_agent_and_all_else_is_kept(
    tmp_path: Path,
) -> None:
    with Journal(tmp_path) as journal:
        journal.owned("o-1", 2**63 - 1)
        journal.stopped(StopOrder("a", "b"))
    with Journal(tmp_path) as journal:
        assert journal.forget_owner() == Owned(owner="o-1", epoch=2**63 - 1)
        assert journal.forget_owner() is None
        journal.accepted(goal("g1"), PLAN, "boot-1")
    with Journal(tmp_path) as journal:
        assert journal.remembrance.owner is None
        assert journal.remembrance.stop == StopOrder("a", "b")
        assert journal.remembrance.lost == ("g1",)


def test_a_folder_that_cannot_be_made_is_answered_by_the_variable_that_names_another(
    tmp_path: Path,
) -> None:
    (tmp_path / "file").write_text("no folder")
    with pytest.raises(JournalError, match="choose a writable folder with NUFLEET_STATE"):
        Journal(tmp_path / "file" / "robot")


def test_an_owner_that_the_disk_does_not_let_go_is_said_and_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with Journal(tmp_path) as journal:
        journal.owned("o-1", 3)
        with monkeypatch.context() as broken:
            broken.setattr("os.fsync", failing)
            with pytest.raises(JournalError, match="free or repair the disk"):
                journal.forget_owner()
    with Journal(tmp_path) as journal:
        assert journal.remembrance.owner == Owned(owner="o-1", epoch=3)


def test_a_journal_is_its_users_alone_also_one_that_was_open_to_others(tmp_path: Path) -> None:
    folder = tmp_path / "lab" / "a" / "journal"
    for open_to_others in (False, True):
        if open_to_others:
            folder.chmod(0o755)
        with Journal(folder) as journal:
            journal.accepted(goal("g1"), PLAN, "boot-1")
            for path in (folder.parents[1], folder.parent, folder, *folder.rglob("*")):
                private = 0o700 if path.is_dir() else 0o600
                assert stat.S_IMODE(path.stat().st_mode) == private, path


@pytest.mark.parametrize("name", ["lock", "log", "incoming/log.new", "incoming/log.damaged"])
def test_a_journal_writes_through_no_link(tmp_path: Path, name: str) -> None:
    folder, victim = tmp_path / "journal", tmp_path / "victim"
    with Journal(folder) as journal:
        journal.stopped(StopOrder("a", "b"))
    if name == "log":
        (folder / LOG).rename(victim)  # what lies there is a log, but not this folder's
    else:
        victim.write_bytes(b"somebody's")
        log = bytearray((folder / LOG).read_bytes())
        log[-1] ^= 1  # so that it is rewritten, and its content is kept
        (folder / LOG).write_bytes(log)
        (folder / name).unlink(missing_ok=True)
    before = victim.read_bytes()
    (folder / name).symlink_to(victim)
    with contextlib.suppress(JournalError), Journal(folder) as journal:
        journal.stopped(StopOrder("c", "d"))
        journal.released("c")
    assert victim.read_bytes() == before
