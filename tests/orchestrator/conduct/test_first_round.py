"""What robots would do is told from their specs, and what they cannot do is refused."""

from __future__ import annotations

import io

import pytest
from puppet_robot import puppet_spec
from rich.console import Console

from nufleet.orchestrator.conduct.first_round import StudyOutlook, check_healths, outlook
from nufleet.orchestrator.jobs import outlook as outlook_job
from nufleet.orchestrator.jobs.outlook import ask_consent, outlook_table
from nufleet.orchestrator.study.interface import Question, StudyPlan
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.robots.health import Health

TEST = Excitation(axis="x", tones=tuple(Tone(omega_rad_s=omega) for omega in (2.0, 5.0)))
PLAN = StudyPlan(target="real", sources=("sim",), band_rad_s=(1.0, 6.0), iterations=7, axis="x")
SPECS = {"real": puppet_spec(simulated=False), "sim": puppet_spec()}
QUESTION = Question(1, {"real": TEST, "sim": TEST})
HEALTHS = {"real": Health(battery=0.5, endurance_s=100.0), "sim": None}


def planned() -> StudyOutlook:
    return outlook(PLAN, QUESTION, SPECS, HEALTHS)


def test_each_robots_test_is_told_with_its_duration_and_limits() -> None:
    real, sim = planned().first_round
    assert (real.robot, real.simulated, real.tones) == ("real", False, 2)
    assert (real.omega_min_rad_s, real.omega_max_rad_s) == (2.0, 5.0)
    assert real.duration_s == duration_s(TEST, SPECS["real"])
    assert (real.reach, real.velocity, real.acceleration) == (1.0, 10.0, 100.0)
    assert (real.battery, real.endurance_s, sim.battery) == (0.5, 100.0, None)
    assert StudyOutlook.model_validate_json(planned().document()) == planned()


def test_robots_that_cannot_finish_are_all_named() -> None:
    check_healths(planned(), HEALTHS)
    healths = {
        "real": Health(ready=False, reason="no position estimate"),
        "sim": Health(endurance_s=1.0),
    }
    with pytest.raises(InvalidInputError, match="real is not ready: no position estimate; sim wou"):
        check_healths(planned(), healths)


def test_the_table_names_real_robots_and_their_batteries() -> None:
    said = io.StringIO()
    Console(file=said, width=200).print(outlook_table(planned()))
    assert "real (real)" in said.getvalue()
    assert "50%, 100 s" in said.getvalue()


def test_real_robots_do_not_move_where_no_person_can_be_asked(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(outlook_job.sys, "stdin", io.StringIO())
    with pytest.raises(InvalidInputError, match=r"real would really move.*give --yes"):
        ask_consent(planned(), Console(quiet=True))
    simulated = {name: puppet_spec() for name in SPECS}
    ask_consent(outlook(PLAN, QUESTION, simulated, HEALTHS), Console(quiet=True))
