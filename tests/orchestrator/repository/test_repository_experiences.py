"""Experiences in the repository: stored once, found by robot, and checked before they are used."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from learned_things import experience
from repository_records import FLEET, SPEC
from sqlalchemy import create_engine

from nufleet.orchestrator.repository.address import parse_url
from nufleet.orchestrator.repository.errors import DamagedRecordError, UnknownRecordError
from nufleet.orchestrator.repository.records import ExperienceRecord, RobotRecord
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.orchestrator.repository.tables import EXPERIENCES
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.file import digest

FIRST, SECOND = experience("source", seed=1), experience("source", seed=2)


def learned(payload: bytes, fleet: str = FLEET, run: str = "run-1") -> ExperienceRecord:
    return ExperienceRecord(fleet, run, payload)


def alter(address: str, **columns: Any) -> None:
    """Change columns of all stored experiences behind the repository's back."""
    engine = create_engine(parse_url(address))
    with engine.begin() as connection:
        connection.execute(EXPERIENCES.update().values(columns))
    engine.dispose()


def test_an_experience_is_found_by_its_robot_in_another_process(
    begun: Repository, address: str
) -> None:
    sha256 = begun.robots.add_experience(learned(FIRST))
    with open_repository(address) as other:
        (found,) = other.robots.experiences(FLEET, "source")
        assert other.robots.experience(FLEET, sha256) == FIRST
        assert other.robots.experiences(FLEET, "target") == ()
        assert other.robots.experiences("attic", "source") == ()
        assert other.robots.experiences(FLEET) == (found,)
    assert sha256 == digest(FIRST) == found.sha256
    assert (found.fleet, found.robot, found.run) == (FLEET, "source", "run-1")
    assert (found.architecture, found.size_bytes) == ("preview", len(FIRST))
    assert abs(datetime.now(UTC) - found.learned_at) < timedelta(minutes=10)


def test_the_experience_that_was_learned_last_comes_first(begun: Repository) -> None:
    for payload in (FIRST, SECOND):
        begun.robots.add_experience(learned(payload))
    found = begun.robots.experiences(FLEET, "source")
    assert [one.sha256 for one in found] == [digest(SECOND), digest(FIRST)]


def test_the_same_bytes_are_stored_once_with_the_run_that_learned_them_last(
    begun: Repository,
) -> None:
    begun.robots.add_experience(learned(FIRST))
    begun.robots.add_experience(learned(SECOND))
    begun.robots.add_experience(learned(FIRST, run="run-2"))
    first, second = begun.robots.experiences(FLEET, "source")
    assert (first.sha256, first.run) == (digest(FIRST), "run-2")
    assert (second.sha256, second.run) == (digest(SECOND), "run-1")
    assert first.learned_at >= second.learned_at


def test_two_fleets_may_learn_the_same_bytes(begun: Repository) -> None:
    begun.robots.describe(RobotRecord("attic", "source", SPEC, "boot-1"))
    for fleet in (FLEET, "attic"):
        begun.robots.add_experience(learned(FIRST, fleet))
    assert [one.fleet for one in begun.robots.experiences("attic", "source")] == ["attic"]
    assert [one.fleet for one in begun.robots.experiences(FLEET, "source")] == [FLEET]
    with pytest.raises(UnknownRecordError, match="fleet cellar"):
        begun.robots.experience("cellar", digest(FIRST))


@pytest.mark.parametrize("payload", [b"", b"model", FIRST[:-5], FIRST + b"\0"])
def test_what_is_no_whole_experience_is_not_stored(begun: Repository, payload: bytes) -> None:
    with pytest.raises(MalformedMessageError):
        begun.robots.add_experience(learned(payload))
    assert begun.robots.experiences(FLEET) == ()


def other_weights(payload: bytes) -> bytes:
    return payload[:-1] + bytes([payload[-1] ^ 1])


@pytest.mark.parametrize(
    ("column", "change", "words"),
    [
        ("payload", other_weights, "sha256"),
        ("payload", lambda payload: payload[:-5], "not a safetensors file"),
        ("payload", lambda payload: b"\0", "truncated"),
        ("payload", lambda payload: b"", "truncated"),
        ("payload", lambda payload: SECOND, "sha256"),
        ("manifest", lambda payload: "null", "manifest"),
        ("robot", lambda payload: "target", "robot"),
        ("architecture", lambda payload: "state", "architecture"),
        ("size_bytes", lambda payload: 7, "size_bytes"),
    ],
)
def test_an_experience_that_was_altered_is_not_given_out_and_heals_when_it_is_stored_again(
    begun: Repository,
    address: str,
    column: str,
    change: Callable[[bytes], object],
    words: str,
) -> None:
    sha256 = begun.robots.add_experience(learned(FIRST))
    alter(address, **{column: change(FIRST)})
    with pytest.raises(DamagedRecordError, match=words) as damaged:
        begun.robots.experience(FLEET, sha256)
    for word in (sha256, "nufleet train --robot"):
        assert word in str(damaged.value)
    begun.robots.add_experience(learned(FIRST))
    assert begun.robots.experience(FLEET, sha256) == FIRST
