"""Axes that disagree on the best source take one each, where that is certain."""

from __future__ import annotations

from learned_things import experience
from rankings_by_axis import RANKING, estimate

from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.orchestrator.study.source_by_axis import in_words, sources_by_axis, way_by_axis
from nufleet.shared.experience.file import decode_experience, digest
from nufleet.shared.wire.messages import ExperienceOffer


def offer(robot: str, *axes: str) -> ExperienceOffer:
    payload = experience(robot, axes=axes)
    manifest = decode_experience(payload).manifest
    return ExperienceOffer(sha256=digest(payload), size_bytes=len(payload), manifest=manifest)


def test_each_axis_takes_the_source_that_is_surely_closer_there() -> None:
    assert sources_by_axis(RANKING) == {"x": "like-x", "y": "like-y"}
    said = in_words(sources_by_axis(RANKING), RANKING)
    assert said.startswith("x from like-x (ψ* = 0.0200, that of even 0.1300) and y from like-y")


def test_the_selected_source_is_taken_where_another_one_may_only_seem_closer() -> None:
    unsure = (RANKING[0], estimate("like-x", 0.2, x=0.02, y=0.28), RANKING[2])
    assert sources_by_axis(unsure) == {"x": "even", "y": "like-y"}
    assert sources_by_axis((RANKING[0], estimate("other", 0.2, x=0.1, y=0.1))) == {}


def test_a_ranking_of_one_axis_says_nothing_of_the_others() -> None:
    assert sources_by_axis((SourceEstimate("one", 0.1, 0.1, 0.1, 1.0, 1),)) == {}
    assert sources_by_axis(()) == {}


def test_a_robot_flies_by_axis_with_what_it_holds_of_the_chosen_sources() -> None:
    held = [offer("like-x", "x", "y"), offer("like-y", "x", "y")]
    way = way_by_axis(held, RANKING)
    assert way is not None
    assert way.prior_sha256 == held[0].sha256
    assert [(one.axis, one.sha256) for one in way.prior_by_axis] == [
        ("x", held[0].sha256),
        ("y", held[1].sha256),
    ]
    assert way_by_axis(held[:1], RANKING) is None, "that of y is not held"
    assert way_by_axis([held[0], offer("like-y", "x")], RANKING) is None, "it never learned y"
