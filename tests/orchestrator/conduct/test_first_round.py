"""What robots would do in a round is told from their specs."""

from __future__ import annotations

import io

import pytest
from puppet_robot import puppet_spec
from rich.console import Console

from nufleet.orchestrator.conduct.first_round import outlook
from nufleet.orchestrator.flights.planned import Outlook, check_healths
from nufleet.orchestrator.runs.plan_table import plan_parts
from nufleet.orchestrator.study.interface import Question, StudyPlan
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import AxisTones, Excitation, Tone
from nufleet.shared.robots.health import Health

TEST = Excitation(axis="x", tones=tuple(Tone(omega_rad_s=omega) for omega in (2.0, 5.0)))
PLAN = StudyPlan(target="real", sources=("sim",), band_rad_s=(1.0, 6.0), iterations=7, axis="x")
SPECS = {"real": puppet_spec(simulated=False), "sim": puppet_spec()}
QUESTION = Question(1, {"real": TEST, "sim": TEST})
HEALTHS = {"real": Health(battery=0.5, endurance_s=100.0), "sim": None}


def planned() -> Outlook:
    return outlook(PLAN, QUESTION, SPECS).with_healths(HEALTHS)


def test_each_robots_test_is_told_with_its_duration_and_the_bounds_that_it_keeps_to() -> None:
    real, sim = planned().motions
    assert (real.robot, real.simulated, sim.simulated) == ("real", False, True)
    assert real.what == "2 tones, 2 to 5 rad/s"
    assert real.duration_s == duration_s(TEST, SPECS["real"])
    # Robots choose 0.8 of what their limits allow.
    assert (real.low, real.high) == ({"x": -0.8}, {"x": 0.8})
    assert (real.velocity, real.acceleration) == (8.0, 80.0)
    assert Outlook.model_validate_json(planned().document()) == planned()


def test_a_test_with_an_amplitude_on_several_axes_is_one_motion_of_all_of_them() -> None:
    tones = AxisTones(axis="y", tones=(Tone(omega_rad_s=3.0),), amplitude=0.2)
    test = TEST.model_copy(update={"amplitude": 0.1, "also": (tones,)})
    (motion,) = outlook(PLAN, Question(1, {"sim": test}), SPECS).motions
    assert motion.high == {"x": 0.1, "y": 0.2}
    assert motion.velocity == 10.0  # the limit itself: the robot refuses what exceeds it


def test_what_is_left_of_an_interrupted_round_is_told_alone() -> None:
    (motion,) = outlook(PLAN, QUESTION, SPECS, {"sim"}).motions
    assert motion.robot == "sim"


def test_the_charge_that_a_motion_uses_is_its_share_of_what_the_battery_lasts() -> None:
    real, sim = planned().robots
    assert real.battery_used == pytest.approx(0.5 * real.duration_s / 100.0)
    assert (sim.battery, sim.battery_used) == (None, None)


def test_robots_that_cannot_finish_are_all_named() -> None:
    check_healths(planned(), HEALTHS)
    healths = {
        "real": Health(ready=False, reason="no position estimate"),
        "sim": Health(endurance_s=1.0),
    }
    with pytest.raises(InvalidInputError, match="real is not ready: no position estimate; sim wou"):
        check_healths(planned(), healths)


def test_the_tables_name_real_robots_and_their_batteries() -> None:
    said = io.StringIO()
    console = Console(file=said, width=200)
    for part in plan_parts(planned()):
        console.print(part)
    assert "real (real)" in said.getvalue()
    assert "50%" in said.getvalue()
    assert "further rounds depend on what this one shows" in said.getvalue()
