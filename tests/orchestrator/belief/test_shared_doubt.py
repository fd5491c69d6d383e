"""What some robots of a fleet show, the others are doubted for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from nufleet.orchestrator.belief.robot_knowledge import RobotKnowledge
from nufleet.orchestrator.belief.shared_doubt import share_doubt
from nufleet.shared.frequency_test.quality import Finding, Quality
from tests.orchestrator.belief.test_robot_knowledge import BAND, LOOP, SPEC, one_test


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
