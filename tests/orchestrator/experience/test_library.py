"""Which of a source's experiences is taken: the newest that is known, at the source or stored."""

from __future__ import annotations

from datetime import UTC, datetime

import pytest

from nufleet.orchestrator.experience.library import KnownExperience, Place, choose
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.layout import Architecture

MAY, JUNE = datetime(2026, 5, 1, tzinfo=UTC), datetime(2026, 6, 1, tzinfo=UTC)


def known(
    name: str, place: Place, learned_at: datetime | None, architecture: Architecture = "preview"
) -> KnownExperience:
    return KnownExperience(name * 64, architecture, place, learned_at, lambda: b"")


def at_source(
    name: str, learned_at: datetime | None, architecture: Architecture = "preview"
) -> KnownExperience:
    return known(name, "robot", learned_at, architecture)


def stored(
    name: str, learned_at: datetime, architecture: Architecture = "preview"
) -> KnownExperience:
    return known(name, "repository", learned_at, architecture)


@pytest.mark.parametrize(
    ("offered", "kept", "name", "place", "words"),
    [
        ([at_source("a", MAY)], [stored("a", MAY)], "a", "robot", "source offers it"),
        ([at_source("a", None)], [], "a", "robot", "source offers it"),
        (None, [stored("a", MAY)], "a", "repository", "source does not answer"),
        ([], [stored("a", MAY)], "a", "repository", "source does not offer preview now"),
        (
            [at_source("b", None)],
            [stored("a", MAY)],
            "b",
            "robot",
            "the repository does not have, which holds aaaaaaaaaaaa… of 2026-05-01 00:00 UTC",
        ),
        (
            [at_source("a", MAY)],
            [stored("b", JUNE), stored("a", MAY)],
            "b",
            "repository",
            "source offers the older aaaaaaaaaaaa… of 2026-05-01 00:00 UTC",
        ),
        (None, [stored("b", JUNE), stored("a", MAY)], "b", "repository", "does not answer"),
    ],
    ids=["same", "not stored", "away", "forgotten", "newer", "older", "newest"],
)
def test_the_newest_known_is_taken_with_the_reason(
    offered: list[KnownExperience] | None,
    kept: list[KnownExperience],
    name: str,
    place: str,
    words: str,
) -> None:
    taken, reason = choose("source", offered, kept, None)
    assert (taken.sha256, taken.place) == (name * 64, place)
    assert words in reason


def test_without_an_architecture_it_is_the_only_one_that_the_source_offers() -> None:
    kept = [stored("b", JUNE, "state"), stored("a", MAY)]
    taken, _ = choose("source", [at_source("a", MAY)], kept, None)
    assert (taken.architecture, taken.place) == ("preview", "robot")
    taken, _ = choose("source", [at_source("a", MAY)], kept, "state")
    assert (taken.architecture, taken.place) == ("state", "repository")


BOTH = [stored("b", JUNE, "state"), stored("a", MAY)]


@pytest.mark.parametrize(
    ("offered", "kept", "architecture", "words"),
    [
        ([], [], None, "it offers none; train one with `nufleet train --robot source`"),
        (None, BOTH, None, "it does not answer, and the repository holds preview and state"),
        ([at_source("a", MAY)], [], "state", "it offers preview; train one"),
        (
            [at_source("a", MAY), at_source("b", MAY, "state")],
            [],
            None,
            "it offers preview and state; .* name one with --architecture",
        ),
    ],
)
def test_none_or_several_is_refused_with_what_there_is(
    offered: list[KnownExperience] | None,
    kept: list[KnownExperience],
    architecture: Architecture | None,
    words: str,
) -> None:
    with pytest.raises(InvalidInputError, match=words):
        choose("source", offered, kept, architecture)
