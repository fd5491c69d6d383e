"""Who is there: told once, whether the question or the watch heard of it first."""

from __future__ import annotations

import threading

from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.shared.wire.presence import Presence

Report = tuple[str, bool]


def reporting() -> tuple[Presence, list[Report]]:
    reports: list[Report] = []
    return Presence(lambda key, alive: reports.append((key, alive))), reports


@settings(deadline=None)
@given(
    asked=st.lists(st.sampled_from("abc"), unique=True),
    watched=st.lists(st.tuples(st.sampled_from("abcd"), st.booleans()), max_size=20),
)
def test_each_change_is_reported_once_and_the_last_word_is_the_watchs(
    asked: list[str], watched: list[Report]
) -> None:
    presence, reports = reporting()
    presence.asked(asked)
    for key, alive in watched:
        presence.watched(key, alive)
    presence.settle(timeout_s=0.0)
    for key in "abcd":
        told = [alive for reported, alive in reports if reported == key]
        assert told == [k % 2 == 0 for k in range(len(told))]  # appears, disappears, appears ...
        said = [alive for mentioned, alive in watched if mentioned == key]
        assert (told[-1] if told else False) == (said[-1] if said else False)


def test_one_that_goes_between_the_question_and_the_watch_is_let_go() -> None:
    presence, reports = reporting()
    presence.asked(["stays", "goes"])
    presence.watched("stays", True)
    presence.settle(timeout_s=0.05)
    assert reports == [("stays", True), ("goes", True), ("goes", False)]
    presence.watched("goes", True)  # it is back
    assert reports[-1] == ("goes", True)


def test_settling_waits_for_the_watch_no_longer_than_it_must() -> None:
    presence, reports = reporting()
    presence.asked(["a"])
    threading.Timer(0.05, presence.watched, ["a", True]).start()
    presence.settle(timeout_s=60.0)
    assert reports == [("a", True)]
    presence.watched("a", False)
    assert reports[-1] == ("a", False)


def test_one_who_joins_is_told_who_is_there_and_hears_every_change_until_it_leaves() -> None:
    presence, reports = reporting()
    presence.asked(["a"])
    presence.watched("a", True)
    presence.settle(timeout_s=0.0)
    late: list[Report] = []

    def told(key: str, alive: bool) -> None:
        late.append((key, alive))

    presence.join(told)
    presence.watched("b", True)
    assert late == reports == [("a", True), ("b", True)]
    assert presence.leave(told)  # the first is left
    presence.watched("b", False)
    assert late == [("a", True), ("b", True)]
    assert reports[-1] == ("b", False)
