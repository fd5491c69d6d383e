"""MAVLink vehicles behind their agents: a study, a drawing, and what ends a flight."""

from __future__ import annotations

import numpy as np
from fleet_lab import KEYS, SLOW, Lab, refusal
from mavlink_air import ROUGH, Air, Unpaced, air

import nufleet
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Tone
from nufleet.shared.wire.messages import Outcome, RobotStatus
from nufleet.sims.mavlink_vehicle.loop import LoopSettings, frequency_response
from nufleet.sims.mavlink_vehicle.vehicle import VehicleSettings

TRACKING = {
    "position_max": 0.6,
    "speed_max": 1.0,
    "acceleration_max": 2.0,
    "correction_max": 0.3,
    "correction_speed_max": 0.5,
}
BAND_RAD_S = (1.0, 5.0)
TARGET, OTHER = LoopSettings(), LoopSettings(omega_rad_s=5.0, damping=0.6, delay_s=0.05)


def flown(loop: LoopSettings = TARGET, *, seed: int = 0, **changes: object) -> Air:
    vehicle = VehicleSettings(loop=loop)
    return air(ROUGH, vehicle, seed=seed, idle_s=3600.0, tracking=TRACKING, **changes)


def response(loop: LoopSettings, omega_rad_s: FloatArray) -> FloatArray:
    late = {"link_delay_s": 0.002, "link_jitter_s": 0.008, "link_loss": 0.01}
    return frequency_response(loop, omega_rad_s, 0.02, feed_forward=True, **late)


def test_a_study_over_a_rough_link_finds_the_distance_of_two_vehicles_and_one_draws(
    lab: Lab,
) -> None:
    robots = {"target": flown(), "other": flown(OTHER, seed=1)}
    for name, one in robots.items():
        lab.agent(name, Unpaced(one.robot))
    orchestrator = lab.orchestrator()
    assert not any(one.vehicle.armed for one in robots.values())
    found = nufleet.rank(
        connect=lab.endpoint,
        fleet_name=KEYS.fleet,
        target="target",
        band_rad_s=BAND_RAD_S,
        iterations=1,
        draws=False,
        rehearses=False,
    )
    omega = np.linspace(*BAND_RAD_S, 41)
    one, two = response(TARGET, omega), response(OTHER, omega)
    psi = np.abs(one - two) / np.sqrt((1 + np.abs(one) ** 2) * (1 + np.abs(two) ** 2))
    (estimate,) = found.ranking
    assert estimate.psi_low <= psi.max() <= estimate.psi_high

    assert orchestrator.draw("target", 0.25) < 0.1


def test_a_pilot_who_takes_over_ends_the_goal_and_the_robot_is_left_to_him(lab: Lab) -> None:
    one = flown()
    agent = lab.agent("a", Unpaced(one.robot))
    orchestrator = lab.orchestrator()
    assert (
        orchestrator.run("a", "before", tones=(Tone(omega_rad_s=5.0),)).outcome is Outcome.COMPLETED
    )
    one.line.at.append((one.clock.now_s + 3.0, lambda: one.vehicle.take_over("position")))
    result = orchestrator.run("a", "test", **SLOW)
    assert result.outcome in {Outcome.FAILED, Outcome.ABORTED}
    assert "a pilot took over (position mode)" in result.reason
    state = orchestrator.state("a", lambda state: state.status is RobotStatus.FAULT)
    assert "a pilot took over" in state.reason
    assert refusal(lambda: orchestrator.submit("a", "again")) in {"fault", "not-ready"}
    agent.close()
    assert (one.vehicle.mode, one.vehicle.armed) == ("position", True)
