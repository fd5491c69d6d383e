"""Learning from nothing looks as far ahead as suits the robot that flies, not a slow source."""

from __future__ import annotations

from learned_things import experience, layout

from nufleet.shared.experience.file import decode_experience
from nufleet.shared.experience.manifest import ExperienceManifest, without_experience

SAMPLE_TIME_S = 0.02


def feedback(horizon_s: float, **changes: object) -> ExperienceManifest:
    samples = round(horizon_s / SAMPLE_TIME_S)
    known = layout("state", horizon_samples=samples, sample_time_s=SAMPLE_TIME_S)
    return decode_experience(experience(layout=known, **changes)).manifest


def test_a_slow_source_does_not_make_none_look_further_ahead() -> None:
    assert without_experience([feedback(0.7)]).horizon_s == 0.4
    assert without_experience([feedback(0.7), feedback(0.6)]).horizon_s == 0.4


def test_of_several_sources_the_quickest_suggests_how_far_none_looks_ahead() -> None:
    for order in ((0.3, 0.2, 0.7), (0.7, 0.3, 0.2)):
        assert without_experience([feedback(each) for each in order]).horizon_s == 0.2


def test_none_never_asks_for_what_a_reference_cannot_influence_yet() -> None:
    assert without_experience([feedback(0.7, relative_degree=25)]).horizon_s == 0.5


def test_a_preview_of_none_is_the_path_itself_and_takes_the_first_layout() -> None:
    layouts = [layout("preview", horizon_samples=h) for h in (30, 20)]
    manifests = [decode_experience(experience(layout=each)).manifest for each in layouts]
    assert without_experience(manifests) == layouts[0]
