"""What a robot flies with when it is not told: a source that was chosen alone, others mixed."""

from __future__ import annotations

from pathlib import Path

from learned_things import experience
from rankings_by_axis import RANKING
from run_records import a_record

from nufleet.orchestrator.history.rankings import Ranking
from nufleet.orchestrator.jobs.held_way import held_way
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.shared.experience.file import decode_experience, digest
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import ExperienceOffer


def offer(robot: str, architecture: Architecture = "state") -> ExperienceOffer:
    payload = experience(robot, architecture, axes=("x", "y"))
    manifest = decode_experience(payload).manifest
    return ExperienceOffer(sha256=digest(payload), size_bytes=len(payload), manifest=manifest)


def ranked(*estimates: SourceEstimate, chosen_way: str = "own") -> Ranking:
    found = {"ranking": estimates, "selected": estimates[0].robot, "chosen_way": chosen_way}
    return Ranking("run", a_record(Path("run")).result.model_copy(update=found))


BOTH = [SourceEstimate(name, psi, psi, psi, 1.0, 1) for name, psi in (("close", 0.1), ("far", 0.4))]
CLOSE, FAR = offer("close"), offer("far")


def test_the_experience_that_the_ranking_selected_flies_alone() -> None:
    name, way = held_way([CLOSE], ranked(*BOTH))
    assert (name, way.inverse, way.prior_sha256) == ("close", "prior", CLOSE.sha256)


def test_the_experience_that_the_target_expects_to_fly_best_with_flies_alone() -> None:
    name, way = held_way([FAR], ranked(*BOTH, chosen_way="far"))
    assert (name, way.inverse, way.prior_sha256) == ("far", "prior", FAR.sha256)


def test_an_experience_that_no_ranking_chose_is_mixed_with_none() -> None:
    for held, ranking in ((FAR, ranked(*BOTH)), (FAR, None), (CLOSE, None)):
        name, way = held_way([held], ranking)
        assert (name, way.inverse) == ("mixture", "mixture")
        assert [(one.sha256, one.weight) for one in way.mixture] == [(held.sha256, 0.5)]


def test_a_preview_flies_alone_as_none_beside_it_is_little_more_than_the_baseline() -> None:
    held = offer("far", "preview")
    name, way = held_way([held], ranked(*BOTH))
    assert (name, way.inverse, way.prior_sha256) == ("far", "prior", held.sha256)


def test_several_experiences_are_mixed_by_their_distance() -> None:
    name, way = held_way([FAR, CLOSE], ranked(*BOTH))
    assert name == "mixture"
    assert [one.sha256 for one in way.mixture] == [FAR.sha256, CLOSE.sha256]
    assert way.mixture[1].weight > 10 * way.mixture[0].weight


def test_each_axis_takes_its_own_source_if_exactly_these_are_held() -> None:
    x, y, even = offer("like-x"), offer("like-y"), offer("even")
    assert held_way([x, y], ranked(*RANKING))[0] == "by-axis"
    assert held_way([x, y, even], ranked(*RANKING))[0] == "mixture"
