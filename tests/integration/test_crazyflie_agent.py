"""A Crazyflie behind its agent: a frequency test and a drawing, flown through cflib over UDP."""

from __future__ import annotations

import pytest
from crazyflie_bench import LOOP, bench
from fleet_lab import Lab, refusal
from polling import wait_until

from nufleet.orchestrator.conduct.attempts import estimated
from nufleet.shared.frequency_test.excitation import Tone
from nufleet.shared.wire.messages import Outcome

pytest.importorskip("cflib")
OMEGA_RAD_S = 12.0


def test_a_test_and_a_drawing_are_flown_and_a_refusal_moves_nothing(lab: Lab) -> None:
    field = lab.stack.enter_context(bench(noise_m=0.0005))
    agent = lab.agent("cf", field.robot)
    orchestrator = lab.orchestrator()
    assert not field.drone.armed
    tested = orchestrator.run("cf", "test", tones=(Tone(omega_rad_s=OMEGA_RAD_S),))
    assert (tested.outcome, tested.reason) == (Outcome.COMPLETED, "")
    response = estimated(tested)
    truth = LOOP.response(response.omega_rad_s[0], 0.02)
    # References that a busy machine sends late scatter the response, which its radius contains.
    assert abs(response.z[0] - truth) < 0.05 + response.radius(1e-4)[0]
    assert tested.timing is not None

    assert orchestrator.draw("cf", 0.2) < 0.1

    field.drone.ailments.battery_v = 3.1
    orchestrator.state("cf", lambda state: "battery is empty" in state.reason)
    assert refusal(lambda: orchestrator.submit("cf", "more")) == "not-ready"
    agent.close()
    assert not field.drone.armed
    wait_until(lambda: field.drone.plant.position_m[2] == 0.0)
