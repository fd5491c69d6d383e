"""What some robots of a fleet show, the others are doubted for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.belief.shared_doubt import share_doubt
from nufleet.shared.frequency_test.quality import Finding, Quality
from tests.orchestrator.belief.test_robot_knowledge import BAND, LOOP, SPEC, Loop, one_test, spread


def test_a_noisy_test_of_one_robot_may_hide_the_distortion_that_others_of_its_kind_show() -> None:
    rng = np.random.default_rng(0)
    finding = Finding(code="nonlinear", text="9 % of it is distortion", value=0.09)
    bent, alike, other = (RobotKnowledge(name, SPEC, BAND[1]) for name in ("r1", "r2", "r3"))
    other.spec = SPEC.model_copy(update={"kind": "another"})
    for known, quality in (
        (bent, Quality(warnings=(finding,))),
        (alike, Quality()),
        (other, Quality()),
    ):
        known.learn(replace(one_test(LOOP, rng), quality=quality), rng)
    share_doubt([alike, other])
    assert not alike.doubted
    share_doubt([bent, alike, other])
    assert bent.doubted
    assert alike.doubted
    assert not other.doubted
    assert alike.findings == ()


def test_what_one_robot_misstates_of_its_settling_is_no_better_from_others_that_state_it_too() -> (
    None
):
    rng = np.random.default_rng(0)
    finding = Finding(code="ringing", text="it needs 90 s to settle to 5 %", value=90.0)
    slow, same, differs = (RobotKnowledge(name, SPEC, BAND[1]) for name in ("r1", "r2", "r3"))
    differs.spec = SPEC.model_copy(update={"settling_time_s": 2 * SPEC.settling_time_s})
    differs.settling_time_s = differs.spec.settling_time_s
    slow.learn(replace(one_test(LOOP, rng), quality=Quality(warnings=(finding,))), rng)
    share_doubt([slow, same, differs])
    assert [one.settling_time_s for one in (slow, same)] == [90.0, 90.0]
    assert slow.misstated
    assert same.misstated
    assert not differs.misstated
    (told,) = same.findings
    assert "correct what the driver states" in told


def test_delays_of_a_whole_kind_are_doubted_where_tests_of_one_robot_are_timed_apart() -> None:
    rng = np.random.default_rng(0)
    twice, once, apart = (RobotKnowledge(name, SPEC, BAND[1]) for name in ("r1", "r2", "r3"))
    apart.spec = SPEC.model_copy(update={"kind": "another"})
    for known in (twice, once, apart):
        known.learn(replace(one_test(LOOP, rng), amplitude=0.2), rng)
    late = Loop(3.0, delay_s=0.05 + 0.015)
    twice.learn(replace(one_test(late, rng), amplitude=0.1), rng)
    (told,) = twice.findings
    assert "ms later than another" in told
    assert twice.by_amplitude is None
    before = spread(once, rng)
    share_doubt([twice, once, apart])
    assert spread(once, rng) > 1.2 * before
    assert twice.doubted
    assert not apart.doubted
