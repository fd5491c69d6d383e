"""Every sample of a paced robot keeps time, is counted, and can be the last one."""

from __future__ import annotations

import time

import numpy as np
import pytest
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.robot_agent.motion.pace import CHUNK_SAMPLES, HaltSwitch, Pace
from nufleet.robot_agent.motion.paced_robot import Halted, PacedRobot
from nufleet.shared.wire.messages import Outcome

REFERENCES = np.stack([np.linspace(0.0, 1.0, 700), np.linspace(1.0, 0.0, 700)], axis=1)


class Paced:
    """A connected puppet that is paced, its switch, and what was counted."""

    def __init__(
        self,
        *,
        realtime: float | None = None,
        sample_time_s: float = 0.01,
        simulated: bool = True,
    ) -> None:
        self.puppet = PuppetRobot(puppet_spec(simulated=simulated, sample_time_s=sample_time_s))
        self.puppet.connect()
        self.switch, self.counted = HaltSwitch(), list[int]()
        pace = Pace(self.puppet.spec, realtime, self.switch)
        self.robot = PacedRobot(self.puppet, pace, self.switch, self.counted.append)


def test_it_is_the_robot_to_whoever_flies_it() -> None:
    paced = Paced()
    assert paced.robot.spec == paced.puppet.spec
    assert paced.robot.state_names == paced.puppet.state_names
    np.testing.assert_array_equal(paced.robot.observe(), paced.puppet.observe())
    np.testing.assert_array_equal(paced.robot.step(REFERENCES[5]), REFERENCES[5])
    paced.robot.rest()
    assert paced.puppet.at_rest


def test_it_does_not_let_go_of_a_robot_that_others_need() -> None:
    paced = Paced()
    paced.robot.disconnect()
    assert paced.puppet.connected


@pytest.mark.parametrize("realtime", [None, 1e9])
def test_all_samples_are_played_in_order_and_counted(realtime: float | None) -> None:
    paced = Paced(realtime=realtime)
    np.testing.assert_array_equal(paced.robot.run(REFERENCES), REFERENCES)
    np.testing.assert_array_equal(np.concatenate(paced.puppet.references), REFERENCES)
    assert paced.counted == sorted(set(paced.counted))
    assert paced.counted[-1] == len(REFERENCES)
    paced.robot.step(REFERENCES[0])
    assert paced.counted[-1] == len(REFERENCES) + 1


def test_a_free_simulation_plays_chunks_and_a_real_robot_single_samples() -> None:
    free, real = Paced(), Paced(simulated=False)
    for one in (free, real):
        one.robot.run(REFERENCES)
    assert free.puppet.batches == [CHUNK_SAMPLES, CHUNK_SAMPLES, 700 - 2 * CHUNK_SAMPLES]
    assert real.puppet.batches == [1] * 700


def test_an_empty_signal_moves_nothing() -> None:
    paced = Paced()
    assert paced.robot.run(REFERENCES[:0]).shape == (0, 2)
    assert paced.counted == []
    assert paced.puppet.motions == 0


def test_a_paced_simulation_takes_its_time() -> None:
    paced = Paced(realtime=2.0, sample_time_s=0.02)
    began_s = time.monotonic()
    paced.robot.run(REFERENCES[:20])
    assert time.monotonic() - began_s >= 19 * 0.02 / 2.0


@pytest.mark.parametrize("simulated", [True, False])
def test_after_the_switch_is_thrown_nothing_moves_any_more(simulated: bool) -> None:
    paced = Paced(simulated=simulated)

    def on_sample(sample: int) -> None:
        if sample == 300:
            paced.switch.halt(Outcome.CANCELLED, "enough")

    paced.puppet.on_sample = on_sample
    with pytest.raises(Halted):
        paced.robot.run(REFERENCES)
    played = paced.puppet.samples
    assert played == (2 * CHUNK_SAMPLES if simulated else 301)
    assert paced.counted[-1] == played
    for again in (lambda: paced.robot.step(REFERENCES[0]), lambda: paced.robot.run(REFERENCES)):
        with pytest.raises(Halted):
            again()
    assert paced.puppet.samples == played


def test_an_error_of_the_robot_passes_through_and_its_sample_is_not_counted() -> None:
    paced = Paced(simulated=False)

    def on_sample(sample: int) -> None:
        if sample == 3:
            raise OSError("the line is dead")

    paced.puppet.on_sample = on_sample
    with pytest.raises(OSError, match="the line is dead"):
        paced.robot.run(REFERENCES)
    assert paced.counted == [1, 2, 3]
