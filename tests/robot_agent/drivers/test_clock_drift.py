"""The drift of a clock is read from the least delayed messages alone."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.robot_agent.drivers.clock_drift import drift

SENT_S = 1.7e9 + np.linspace(0.0, 60.0, 61)


def test_messages_that_waited_do_not_change_the_drift() -> None:
    waited_s = np.random.default_rng(1).exponential(0.05, len(SENT_S))
    waited_s[[7, 53]] = 0.0
    delays_s = 0.003 + 4e-5 * (SENT_S - SENT_S[0]) + waited_s
    assert drift(SENT_S, delays_s, drift_max=1e-3) == pytest.approx(4e-5, rel=1e-6)


@pytest.mark.parametrize("rate", [-2e-3, 2e-3])
def test_a_drift_that_no_clock_has_is_cut_to_the_largest(rate: float) -> None:
    found = drift(SENT_S, rate * (SENT_S - SENT_S[0]), drift_max=2e-4)
    assert found == np.copysign(2e-4, rate)
