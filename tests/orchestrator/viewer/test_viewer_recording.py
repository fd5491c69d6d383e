"""What a study leaves in its recording, read back from the file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recording_reader import column, entities, scalars
from study_events import SAMPLE_TIME_S, iteration_event, samples_event, state_event

from nufleet.orchestrator.viewer.events import MessageEvent, ViewerEvent
from nufleet.orchestrator.viewer.rerun_sink import RerunSink
from nufleet.orchestrator.viewer.writer import RerunWriter
from nufleet.shared.errors import InvalidInputError, NufleetError


def record(path: Path, *events: ViewerEvent) -> Path:
    with RerunWriter("run-1", recording=path, serve=None) as writer:
        for event in events:
            writer.emit(event)
    assert writer.dropped == 0
    return path


def test_a_test_is_recorded_sample_by_sample_from_its_start(tmp_path: Path) -> None:
    event = samples_event("s1", t_s=7.5)
    path = record(tmp_path / "run.rrd", event)
    for signal, expected in (("reference", event.reference), ("response", event.response)):
        times_s, values = scalars(path, f"/tests/{signal}/s1/x")
        np.testing.assert_array_equal(values, expected)
        np.testing.assert_allclose(times_s, 7.5 + np.arange(400) * SAMPLE_TIME_S, atol=1e-8)


def test_a_long_test_keeps_its_peaks_in_a_bounded_number_of_points(tmp_path: Path) -> None:
    event = samples_event("s1", samples=60_001)
    event.response[31_234] = 5.0
    path = record(tmp_path / "run.rrd", event)
    times_s, values = scalars(path, "/tests/response/s1/x")
    assert 1000 <= len(values) <= 2000
    assert values.max() == 5.0
    assert times_s[values.argmax()] == pytest.approx(31_234 * SAMPLE_TIME_S)


def test_a_round_draws_every_robot_and_every_source(tmp_path: Path) -> None:
    paths = entities(record(tmp_path / "run.rrd", iteration_event()))
    for source in ("s1", "s2", "s3"):
        assert f"/sphere/points/{source}" in paths
        assert f"/sphere/chords/{source}" in paths
        assert f"/psi/worst/{source}/median" in paths
    assert "/sphere/points/target" in paths
    assert "/sphere/chords/target" not in paths


def test_estimates_carry_their_intervals_on_both_timelines(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", *(iteration_event(k, t_s=5.0 * k) for k in (1, 2)))
    for timeline in ("t", "iteration"):
        for part, value in (("median", 0.04), ("low", 0.032), ("high", 0.052)):
            drawn = column(path, f"/psi/worst/s2/{part}", "Scalars:scalars", timeline)
            np.testing.assert_allclose(np.array(drawn), [[value], [value]])


def test_a_lane_changes_only_when_the_status_does(tmp_path: Path) -> None:
    statuses = ["idle", "running", "running", "running", "fault"]
    events = [state_event("s1", 0.1 * k, status) for k, status in enumerate(statuses)]
    path = record(tmp_path / "run.rrd", *events)
    assert column(path, "/state/2-source/s1", "StateChange:state") == [
        ["idle"],
        ["running"],
        ["fault"],
    ]


def test_tests_that_still_run_are_drawn_before_their_round_is_over(tmp_path: Path) -> None:
    robots = ("target", "s1", "s2")
    events = [replace(samples_event(r, samples=800), robots=robots) for r in robots]
    path = record(tmp_path / "run.rrd", *events)
    looks = column(path, "/psi/worst/s1/running", "Scalars:scalars")
    assert len(looks) > 5
    assert {f"/{what}/s1" for what in ("sphere/points", "sphere/chords", "psi/running")} <= set(
        entities(path)
    )
    assert "/difference/sources/s2" in entities(path)
    (text,) = column(path, "/ranking", "TextDocument:text")[-1]
    assert "Tests in progress" in text


def test_the_rounds_end_takes_the_place_of_what_was_drawn_before_it(tmp_path: Path) -> None:
    events = [samples_event(robot, samples=800) for robot in ("target", "s1")]
    path = record(tmp_path / "run.rrd", *events, iteration_event(t_s=12.5))
    assert column(path, "/psi/running/s1", "Clear:is_recursive") == [[False]]
    (text,) = column(path, "/ranking", "TextDocument:text")[-1]
    assert "Iteration 1" in text


def test_messages_are_recorded_with_their_levels(tmp_path: Path) -> None:
    path = record(
        tmp_path / "run.rrd",
        MessageEvent(1.0, "warning", "s1 is slow"),
        iteration_event(t_s=2.0),
    )
    assert column(path, "/log", "TextLog:text") == [
        ["    1.0 s  s1 is slow"],
        ["    2.0 s  round 1 at ω = 2 rad/s: s1 is closest, worst ψ = 0.0200 (0.0160 to 0.0260)"],
        ["    2.0 s  s4 was dropped"],
    ]
    assert column(path, "/log", "TextLog:level") == [["WARN"], ["INFO"], ["INFO"]]


def test_a_recording_is_not_written_over(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", iteration_event())
    before = path.read_bytes()
    with pytest.raises(InvalidInputError, match="already exists"):
        RerunWriter("run-2", recording=path, serve=None).open()
    assert path.read_bytes() == before


def test_a_recording_that_cannot_be_written_is_refused_at_once(tmp_path: Path) -> None:
    with pytest.raises(InvalidInputError, match="No such file or directory"):
        RerunWriter("run-1", recording=tmp_path / "missing" / "run.rrd", serve=None).open()


def test_a_test_that_comes_in_parts_is_drawn_as_one_line(tmp_path: Path) -> None:
    whole = samples_event("s1", t_s=2.0, samples=400)
    parts = [
        replace(
            whole,
            t_s=2.0 + first * SAMPLE_TIME_S,
            reference=whole.reference[first : first + 50],
            response=whole.response[first : first + 50],
        )
        for first in range(0, 400, 50)
    ]
    times_s, values = scalars(record(tmp_path / "run.rrd", *parts), "/tests/response/s1/x")
    np.testing.assert_array_equal(values, whole.response)
    np.testing.assert_allclose(times_s, 2.0 + np.arange(400) * SAMPLE_TIME_S, atol=1e-8)


def test_an_event_that_cannot_be_drawn_costs_nothing_but_itself(
    tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    good = iteration_event(2, t_s=9.0)
    curve = replace(good.curves[0], median=np.zeros(3))
    path = record(tmp_path / "run.rrd", replace(good, iteration=1, curves=(curve,)), good)
    assert "could not draw" in caplog.text
    assert column(path, "/psi/worst/s2/median", "Scalars:scalars") == [[0.04]]


def test_a_robot_that_did_not_answer_is_taken_off_the_sphere(tmp_path: Path) -> None:
    first, second = (iteration_event(k, t_s=5.0 * k) for k in (1, 2))
    answers = {robot: z for robot, z in second.responses.items() if robot != "s3"}
    path = record(tmp_path / "run.rrd", first, replace(second, responses=answers))
    assert column(path, "/sphere/points/s3", "Clear:is_recursive") == [[False]]
    assert column(path, "/sphere/points/s2", "Clear:is_recursive") == []


def test_a_study_that_lost_its_target_is_still_drawn(tmp_path: Path) -> None:
    event = iteration_event()
    answers = {robot: z for robot, z in event.responses.items() if robot != "target"}
    path = record(tmp_path / "run.rrd", replace(event, responses=answers))
    assert column(path, "/psi/worst/s2/median", "Scalars:scalars") == [[0.04]]
    assert "/sphere/points/s1" in entities(path)
    assert "/sphere/chords/s1" not in entities(path)


def test_a_recording_whose_file_takes_nothing_more_says_so_in_one_error(tmp_path: Path) -> None:
    sink = RerunSink.to_file("run", tmp_path / "run.rrd")

    def full() -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    broken = RerunSink(sink._stream, full)
    with pytest.raises(NufleetError, match=r"its disk is full.*File-writer thread"):
        broken.write([iteration_event(1)])
    with pytest.raises(NufleetError, match="its disk is full"):
        broken.close()
    sink.close()
