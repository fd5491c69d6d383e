"""What is shown of tests while they run: responses that settle on those of the robots."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from nufleet.orchestrator.viewer.events import Answers, TestSamplesEvent
from nufleet.orchestrator.viewer.running_tests import PATIENCE, RunningTests, largest_psi
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.frequency_test.excitation import Tone

STEP_S = 0.02
TONES_RAD_S = (1.0, 2.5, 6.0)
TONES = tuple(Tone(omega_rad_s=w, phase_rad=0.7 * w + math.pi / 2) for w in TONES_RAD_S)
ROBOTS = ("target", "near", "far")


def z_of(robot: str, omega_rad_s: float) -> complex:
    pole = {"target": 2.0, "near": 2.5, "far": 8.0}[robot]
    return pole / (pole + 1j * omega_rad_s)


def samples(
    robot: str, begin_s: float, end_s: float, robots: tuple[str, ...] = ("target", "near")
) -> TestSamplesEvent:
    """Samples from one time to another of a robot that has settled."""
    time_s = np.arange(round(begin_s / STEP_S), round(end_s / STEP_S)) * STEP_S
    waves = [np.exp(1j * (omega * time_s + 0.7 * omega)) for omega in TONES_RAD_S]
    response = sum(z_of(robot, w) * wave for w, wave in zip(TONES_RAD_S, waves, strict=True))
    return TestSamplesEvent(
        time_s[0], robot, "x", "m", "target", robots, TONES, STEP_S, np.real(sum(waves)),
        0.3 + np.real(response),
    )  # fmt: skip


@given(st.integers(1, 40))
def test_in_whatever_parts_the_samples_come_the_responses_become_the_robots(parts: int) -> None:
    running, whole_s = RunningTests(), 4 * math.pi
    for part in range(parts):
        for robot in ROBOTS:
            limits = (part * whole_s / parts, (part + 1) * whole_s / parts)
            running.add(samples(robot, *limits, ROBOTS))
        looks = list(running.look())
    last = looks[-1]
    assert last.t_s == pytest.approx(whole_s, abs=2 * STEP_S)
    assert last.omega_rad_s == TONES_RAD_S
    assert last.leaders == ("near", "far")
    for robot in ROBOTS:
        expected = {omega: z_of(robot, omega) for omega in TONES_RAD_S}
        assert last.responses[robot] == pytest.approx(expected, abs=0.02)
    exact = {r: np.array([z_of(r, w) for w in TONES_RAD_S]) for r in ROBOTS}
    for source, psi in largest_psi(last).items():
        true = chordal_distance(exact[source], exact["target"]).max()
        assert psi == pytest.approx(true, abs=0.02)


def test_a_tone_is_shown_once_it_has_come_apart_from_its_neighbours_by_a_period() -> None:
    running = RunningTests()
    looks: list[Answers] = []
    for begin_s in np.arange(0.0, 8.0, 0.5).tolist():
        for robot in ("target", "near"):
            running.add(samples(robot, begin_s, begin_s + 0.5))
        looks += running.look()
    seen = [answers.omega_rad_s for answers in looks]
    assert seen[0] == (6.0,)
    assert looks[0].t_s == pytest.approx(2 * math.pi / (6.0 - 2.5), abs=0.25)
    assert seen[-1] == TONES_RAD_S
    assert seen == sorted(seen, key=len)


def test_tests_that_arrive_one_after_another_are_shown_side_by_side() -> None:
    running = RunningTests()
    running.add(samples("target", 0.0, 30.0))
    assert list(running.look()) == []
    running.add(samples("near", 0.0, 30.0))
    looks = list(running.look())
    assert len(looks) >= 10
    times_s = [answers.t_s for answers in looks]
    assert times_s == sorted(set(times_s))
    assert times_s[-1] == pytest.approx(30.0)
    assert all(answers.responses.keys() == {"target", "near"} for answers in looks)
    assert list(running.look()) == []


def test_a_robot_that_repeats_its_test_begins_it_again() -> None:
    running = RunningTests()
    for robot in ("target", "near", "target"):
        running.add(samples(robot, 0.0, 12.0))
    assert list(running.look())[-1].responses.keys() == {"target", "near"}


def test_the_way_back_to_rest_changes_nothing_any_more() -> None:
    running = RunningTests()
    for robot in ("target", "near"):
        test = samples(robot, 0.0, 15.0)
        fall = np.clip((15.0 - np.arange(len(test.reference)) * STEP_S) / 2.0, 0.0, 1.0)
        running.add(replace(test, reference=fall * test.reference, response=fall * test.response))
    looks = list(running.look())
    before, last = (looks[k].responses["near"] for k in (-5, -1))
    assert last == pytest.approx(before, abs=0.005)


def test_samples_that_are_lost_on_the_way_do_not_begin_the_test_again() -> None:
    running = RunningTests()
    for robot in ("target", "near"):
        for begin_s, end_s in ((0.0, 4.0), (6.0, 12.0)):
            running.add(samples(robot, begin_s, end_s))
    last = list(running.look())[-1]
    expected = {omega: z_of("near", omega) for omega in TONES_RAD_S}
    assert last.responses["near"] == pytest.approx(expected, abs=0.02)


def test_a_robot_that_fell_silent_is_waited_for_but_not_for_ever() -> None:
    running = RunningTests()
    running.add(samples("far", 0.0, 7.0, ROBOTS))
    for k in range(2 * PATIENCE):
        for robot in ("target", "near"):
            running.add(samples(robot, float(k), k + 1.0, ROBOTS))
        for answers in running.look():
            assert answers.t_s <= (7.0 if k < PATIENCE else k + 1.0) + 1e-9
    assert answers.t_s == pytest.approx(2.0 * PATIENCE)


def test_the_last_look_waits_for_no_robot() -> None:
    running = RunningTests()
    running.add(samples("far", 0.0, 7.0, ROBOTS))
    running.add(samples("near", 0.0, 9.0, ROBOTS))
    assert list(running.look()) == []
    assert list(running.look(last=True))[-1].t_s == pytest.approx(9.0)


def test_after_a_round_its_best_sources_lead_the_next_one() -> None:
    running = RunningTests()
    running.end(("far", "near"))
    for robot in ROBOTS:
        running.add(samples(robot, 0.0, 10.0, ROBOTS))
    assert list(running.look())[-1].leaders == ("far", "near")
    running.end(("near",))
    assert list(running.look()) == []
