"""What the journal's records say together, and that a shorter journal says the same."""

from __future__ import annotations

from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st
from journal_facts import DIGEST, PLAN, content

from nufleet.robot_agent.journal import ledger as journal_ledger
from nufleet.robot_agent.journal.ledger import (
    Accepted,
    Acknowledged,
    Ended,
    JournalError,
    Ledger,
    Owned,
    Record,
    Released,
    Remembered,
    Stopped,
    decode_record,
    encode_record,
)
from nufleet.robot_agent.rules.goal_machine import Goals, recognise
from nufleet.robot_agent.rules.kept_results import KEPT_RESULT_BYTES, KEPT_RESULTS
from nufleet.robot_agent.rules.supervisor import StopOrder
from nufleet.shared.wire.messages import Outcome, Refusal

IDS = st.sampled_from(["g1", "g2", "g3", "g4"])
OUTCOMES = st.sampled_from(list(Outcome))
HASHES = st.none() | st.just("a" * 64)


def accepted(goal_id: str) -> Accepted:
    return Accepted(goal_id=goal_id, owner="o", digest=DIGEST, boot_id="boot-1", plan=PLAN)


def ended(goal_id: str, size_bytes: int = 8) -> Ended:
    outcome = Outcome.COMPLETED
    return Ended(goal_id=goal_id, outcome=outcome, sha256="a" * 64, size_bytes=size_bytes)


RECORDS: st.SearchStrategy[Record] = st.one_of(
    IDS.map(accepted),
    st.builds(Ended, goal_id=IDS, outcome=OUTCOMES, sha256=HASHES, size_bytes=st.integers(0, 9)),
    st.builds(
        Remembered,
        goal_id=IDS,
        owner=st.just(""),
        digest=st.just(""),
        outcome=OUTCOMES,
        sha256=HASHES,
        size_bytes=st.just(1),
    ),
    st.builds(Acknowledged, goal_ids=st.lists(IDS, max_size=3).map(tuple)),
    st.builds(Stopped, sender=st.just("s"), reason=st.text(max_size=20)),
    st.builds(Released, sender=st.just("s")),
    st.builds(Owned, owner=st.sampled_from(["a", "b"]), epoch=st.integers(0, 2**62)),
)


def ledger_of(records: Any) -> Ledger:
    ledger = Ledger()
    for record in records:
        ledger.apply(record)
    return ledger


@given(record=RECORDS)
def test_a_record_comes_back_as_it_was_written(record: Record) -> None:
    assert decode_record(encode_record(record)) == record


@pytest.mark.parametrize("payload", [b"", b"{}", b'{"kind": "flown"}', b"\xff", b"[1"])
def test_a_record_of_another_nufleet_is_refused(payload: bytes) -> None:
    with pytest.raises(JournalError, match="a different version of nufleet"):
        decode_record(payload)


@given(records=st.lists(RECORDS, max_size=12), later=st.lists(RECORDS, max_size=4))
def test_a_journal_written_anew_says_the_same_now_and_later(
    records: list[Record], later: list[Record]
) -> None:
    ledger = ledger_of(records)
    shorter = ledger_of(list(ledger.records()))
    assert content(shorter) == content(ledger)
    for record in later:
        assert shorter.apply(record) == ledger.apply(record)
    assert content(shorter) == content(ledger)


@given(records=st.lists(RECORDS, max_size=12), record=RECORDS)
def test_what_it_says_already_changes_nothing(records: list[Record], record: Record) -> None:
    ledger = ledger_of(records)
    before = content(ledger)
    if ledger.says_already(record):
        ledger.apply(record)
        assert content(ledger) == before


def test_a_goal_runs_until_it_has_ended_and_its_result_is_kept_until_it_is_acknowledged() -> None:
    ledger = ledger_of([accepted("g1")])
    assert [known.goal.goal_id for known in ledger.running] == ["g1"]
    ledger.apply(ended("g1"))
    assert (ledger.running, ledger.kept) == ((), ("g1",))
    assert ledger.apply(Acknowledged(goal_ids=("g1", "g9"))) == ("g1",)
    assert ledger.kept == ()
    assert ledger.goals["g1"].goal.outcome is Outcome.COMPLETED


def test_a_goal_that_has_ended_never_runs_again() -> None:
    ledger = ledger_of([accepted("g1"), ended("g1"), accepted("g1")])
    assert ledger.running == ()


def test_the_first_stop_stays_until_a_release() -> None:
    ledger = ledger_of([Stopped(sender="a", reason="1"), Stopped(sender="b", reason="2")])
    assert ledger.stop == StopOrder("a", "1")
    ledger.apply(Released(sender="c"))
    assert ledger.stop is None


def test_an_end_whose_acceptance_was_damaged_still_keeps_its_goal_from_moving_again() -> None:
    ledger = ledger_of([ended("g1")])
    goals = Goals({goal_id: known.goal for goal_id, known in ledger.goals.items()})
    assert isinstance(recognise(goals, goal_id="g1", digest=DIGEST), Refusal)


def test_the_oldest_results_are_let_go_beyond_the_bounds() -> None:
    ledger = Ledger()
    gone: list[str] = []
    for n in range(KEPT_RESULTS + 3):
        ledger.apply(accepted(f"g{n}"))
        gone += ledger.apply(ended(f"g{n}"))
    assert gone == ["g0", "g1", "g2"]
    assert len(ledger.kept) == KEPT_RESULTS
    ledger.apply(accepted("big"))
    assert len(ledger.apply(ended("big", KEPT_RESULT_BYTES + 1))) == KEPT_RESULTS
    assert ledger.kept == ("big",)


def test_a_goal_that_runs_is_not_forgotten_for_those_cancelled_meanwhile(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(journal_ledger, "REMEMBERED_GOALS", 3)
    ledger = ledger_of([accepted("g1")])
    for n in range(5):
        forgone = Ended(goal_id=f"f{n}", outcome=Outcome.CANCELLED, sha256=None, size_bytes=0)
        ledger.apply(forgone)
        assert ledger.says_already(forgone)
        assert [known.goal.goal_id for known in ledger.running] == ["g1"]
        assert content(ledger_of(ledger.records())) == content(ledger)
    assert list(ledger.goals) == ["g1", "f3", "f4"]


def test_the_oldest_goals_are_forgotten_beyond_the_bound(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(journal_ledger, "REMEMBERED_GOALS", 3)
    ledger = Ledger()
    gone: list[str] = []
    for n in range(5):
        gone += ledger.apply(accepted(f"g{n}"))
        gone += ledger.apply(ended(f"g{n}"))
    assert list(ledger.goals) == ["g2", "g3", "g4"]
    assert (gone, ledger.kept) == (["g0", "g1"], ("g2", "g3", "g4"))
