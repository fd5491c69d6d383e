"""What flights along paths leave in a recording, read back from the file."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from recording_reader import column, entities, scalars
from study_events import iteration_event
from tracking_events import SAMPLE_TIME_S, flight, parts

from nufleet.orchestrator.viewer.draw.errors import HEIGHT, WIDTH
from nufleet.orchestrator.viewer.events import MessageEvent, TakenBackEvent, ViewerEvent
from nufleet.orchestrator.viewer.rerun_sink import RerunSink
from nufleet.orchestrator.viewer.writer import RerunWriter

LATE_MM = 1e3 * 2 * np.sin(np.pi * 0.1 / 10)
"""How far the robot of `flight` is from its path, a circle of 1 m, when 0.1 s late."""


def record(path: Path, *events: ViewerEvent) -> Path:
    with RerunWriter("run-1", recording=path, serve=None) as writer:
        for event in events:
            writer.emit(event)
    assert writer.dropped == 0
    return path


def taken_back(t_s: float, prior: str = "s1") -> TakenBackEvent:
    return TakenBackEvent(t_s, "target", f"{prior} · circle · 0.6 m/s", "it was worse")


def test_the_error_is_recorded_in_millimetres_by_who_gave_the_prior(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", flight("baseline"), flight("s1", t_s=15.0, late_s=0.05))
    times_s, error = scalars(path, "/tracking/error/target/s1")
    np.testing.assert_allclose(error, LATE_MM / 2, rtol=1e-3)
    assert (times_s[0], times_s[-1]) == pytest.approx((15.0, 15.0 + 499 * SAMPLE_TIME_S), abs=0.05)
    np.testing.assert_allclose(scalars(path, "/tracking/error/target/baseline")[1], LATE_MM)


def test_angles_are_recorded_in_milliradians(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", flight(unit="rad"))
    assert "RMS tracking error** in mrad" in table(path)
    assert "RMS error [mrad]" in names(path)


@pytest.mark.parametrize("axes", [("x",), ("x", "y"), ("x", "y", "z")])
def test_the_inverse_model_is_recorded_for_every_axis(
    tmp_path: Path, axes: tuple[str, ...]
) -> None:
    event = flight(axes=axes, samples=100)
    path = record(tmp_path / "run.rrd", event)
    for n, axis in enumerate(axes):
        kept = {round(float(v), 9) for v in scalars(path, f"/tracking/prior/{axis}/target")[1]}
        assert kept <= {round(float(v), 9) for v in event.prior[:, n]}
        entity = f"/tracking/gp/{axis}/target"
        means = np.array([v for v in column(path, entity, "Measurements:values") if v])
        assert means.max() == pytest.approx(event.mean[:, n].max())
        # The band drawn is of one deviation, so it is given two.
        variances = np.array([v for v in column(path, entity, "Measurements:variances") if v])
        np.testing.assert_allclose(variances, 4 * 0.0025)


def test_the_weights_of_a_mixture_are_recorded_by_source(tmp_path: Path) -> None:
    event = flight("mixture", samples=100)
    toward = np.linspace(0.5, 0.9, 100)
    weights = np.stack([toward, 0.1 * np.ones(100), 0.9 - toward], axis=1)
    mixed = replace(event, experts=("s1", "s2"), weights=weights)
    path = record(tmp_path / "run.rrd", flight("s1", t_s=-5.0, samples=50), mixed)
    for column_of, name in enumerate(("s1", "s2", "none")):
        found = scalars(path, f"/tracking/weights/target/{name}")[1]
        assert (found[0], found[-1]) == pytest.approx(
            (weights[0, column_of], weights[-1, column_of])
        )
    alone = record(tmp_path / "alone.rrd", flight("s1", samples=50))
    assert not [entity for entity in entities(alone) if "weights" in entity]


def test_a_baseline_has_no_inverse_model_to_show(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", flight("baseline"))
    shown = entities(path)
    assert not any(
        p.startswith(("/tracking/gp", "/tracking/prior", "/tracking/share")) for p in shown
    )


def test_the_share_is_recorded_where_it_changes(tmp_path: Path) -> None:
    share = np.concatenate([np.ones(200), np.linspace(1, 0, 21)[1:], np.zeros(280)])
    path = record(tmp_path / "run.rrd", flight(share=share))
    times_s, values = scalars(path, "/tracking/share/target")
    all_s = np.arange(len(share)) * SAMPLE_TIME_S
    np.testing.assert_allclose(np.interp(all_s, times_s, values), share, atol=1e-12)
    assert len(values) < 30


@pytest.mark.parametrize("samples", [1, 13, 500])
def test_a_flight_in_parts_is_drawn_to_its_end(tmp_path: Path, samples: int) -> None:
    event = flight()
    path = record(tmp_path / "run.rrd", *parts(event, samples))
    trails = column(path, "/tracking/plot/path/trail", "LineStrips2D:strips")
    np.testing.assert_allclose(trails[-1][0][-1], event.actual[-1], rtol=1e-6)  # type: ignore[index]
    assert len(trails) >= 10.0 / 0.25 - 1
    places = column(path, "/tracking/plot/path/trail", "Points2D:positions")
    np.testing.assert_allclose(places[-1][0], event.actual[-1], rtol=1e-6)  # type: ignore[index]
    bodies = column(path, "/tracking/plot/path/actual", "LineStrips2D:strips")
    np.testing.assert_allclose(last(bodies)[0][-1], event.actual[450], rtol=1e-6)
    assert "/tracking/plot/path/earlier" in entities(path)


def last(rows: list[object]) -> list[list[list[float]]]:
    return [row for row in rows if row][-1]  # type: ignore[return-value]


def test_the_wanted_path_stays_whole_while_it_is_flown_again(tmp_path: Path) -> None:
    first, second = flight("baseline"), flight("s1", t_s=15.0, samples=100)
    path = record(tmp_path / "run.rrd", *parts(first, 50), second)
    wanted = last(column(path, "/tracking/plot/path/desired", "LineStrips2D:strips"))
    np.testing.assert_allclose(wanted[0][-1], first.desired[-1], rtol=1e-6)


def test_earlier_flights_along_the_same_path_stay_and_others_go(tmp_path: Path) -> None:
    events = [flight(prior, t_s=15.0 * k) for k, prior in enumerate(("baseline", "s1", "s2"))]
    path = record(tmp_path / "a.rrd", *events)
    earlier = column(path, "/tracking/plot/path/earlier", "LineStrips2D:strips")
    assert [len(strips or []) for strips in earlier] == [0, 1, 2]  # type: ignore[arg-type]
    other = flight("s1", path="square · 0.6 m/s", t_s=45.0)
    path = record(tmp_path / "b.rrd", *events, other)
    earlier = column(path, "/tracking/plot/path/earlier", "LineStrips2D:strips")
    assert [len(strips or []) for strips in earlier] == [0, 1, 2, 0]  # type: ignore[arg-type]


def test_a_flight_that_is_sent_again_whole_replaces_what_came_of_it(tmp_path: Path) -> None:
    event = flight("s1", t_s=15.0)
    lossy = [part for n, part in enumerate(parts(event, 50)) if n != 3]
    path = record(tmp_path / "run.rrd", flight("baseline", late_s=0.2), *lossy, event)
    earlier = column(path, "/tracking/plot/path/earlier", "LineStrips2D:strips")
    assert len(earlier[-1]) == 1  # type: ignore[arg-type]
    assert [row.split()[0] for row in names(path).splitlines()[2:]] == ["s1", "baseline"]
    trails = column(path, "/tracking/plot/path/trail", "LineStrips2D:strips")
    np.testing.assert_allclose(trails[-1][0][-1], event.actual[-1], rtol=1e-6)  # type: ignore[index]


def test_the_place_where_the_prior_was_taken_back_is_marked(tmp_path: Path) -> None:
    event = flight()
    path = record(tmp_path / "run.rrd", *parts(event, 100), taken_back(3.0))
    labels = column(path, "/tracking/plot/path/taken_back", "Points2D:labels")
    assert labels[-1] == ["prior withdrawn"]
    places = column(path, "/tracking/plot/path/taken_back", "Points2D:positions")
    np.testing.assert_allclose(places[-1][0], event.actual[150], rtol=1e-5)  # type: ignore[index]
    for signal, value in (("share", 1.0), ("error", LATE_MM)):
        times_s, values = scalars(path, f"/tracking/taken_back/{signal}/target")
        assert (times_s[0], values[0]) == pytest.approx((3.0, value))
    assert column(path, "/log", "TextLog:text") == [
        ["    3.0 s  s1 · circle · 0.6 m/s: prior withdrawn: it was worse"]
    ]
    assert column(path, "/log", "TextLog:level") == [["WARN"]]


def test_a_mark_waits_for_the_samples_that_it_stands_at(tmp_path: Path) -> None:
    event = flight()
    first, second = parts(event, 250)
    path = record(tmp_path / "run.rrd", first, taken_back(7.0), second)
    places = column(path, "/tracking/plot/path/taken_back", "Points2D:positions")
    np.testing.assert_allclose(places[-1][0], event.actual[350], rtol=1e-5)  # type: ignore[index]
    assert scalars(path, "/tracking/taken_back/share/target")[0] == pytest.approx([7.0])


def test_the_next_flight_carries_no_mark_of_the_last(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", flight(), taken_back(3.0), flight("s2", t_s=15.0))
    assert column(path, "/tracking/plot/path/taken_back", "Clear:is_recursive")[-1] == [False]
    assert "withdrawn" in names(path)


def test_lines_are_broken_between_flights(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", flight("s1"), flight("s1", t_s=15.0))
    for signal in ("error/target/s1", "share/target", "gp/x/target", "prior/y/target"):
        assert [False] in column(path, f"/tracking/{signal}", "Clear:is_recursive"), signal


def table(path: Path) -> str:
    return str(column(path, "/tracking/flights", "TextDocument:text")[-1][0])  # type: ignore[index]


def names(path: Path) -> str:
    labels = column(path, "/tracking/plot/names", "Points2D:labels")
    return "\n".join(labels[-1])  # type: ignore[arg-type]


def test_the_table_at_the_end_holds_the_error_of_the_whole_last_flight(tmp_path: Path) -> None:
    """It is written once per second: without an end, the last second would be missing."""
    sink = RerunSink.to_file("run-1", tmp_path / "run.rrd")
    late = flight("s1")
    late.actual[-20:] += 1.0
    for part in parts(late, 25):
        sink.write([part])
    sink.close()
    away = late.actual - late.desired
    rms_mm = 1e3 * np.sqrt(np.mean(np.sum(away**2, axis=1)))
    assert f"{rms_mm:.1f}" in table(tmp_path / "run.rrd")


def test_errors_along_the_same_path_are_compared_from_the_start_of_each_flight(
    tmp_path: Path,
) -> None:
    flights = [flight("baseline"), flight("s1", t_s=15.0, late_s=0.05)]
    flights += [flight("s2", t_s=30.0, late_s=0.02)]
    path = record(tmp_path / "run.rrd", *flights, taken_back(32.0, "s2"))
    earlier = column(path, "/tracking/compared/earlier", "LineStrips2D:strips")[-1]
    (last,) = column(path, "/tracking/compared/flight", "LineStrips2D:strips")[-1]
    assert isinstance(earlier, list)
    # All begin at the left edge and end at the same time; three heights below one another.
    for line in (*earlier, last):
        assert line[0][0] == 0.0
        assert line[-1][0] == pytest.approx(499 / 500 * WIDTH, rel=1e-3)
    baseline, s1, s2 = (HEIGHT - line[0][1] for line in (*earlier, last))
    assert (s1 / baseline, s2 / baseline) == pytest.approx((0.5, 0.2), rel=0.01)
    ((mark,),) = column(path, "/tracking/compared/taken_back", "Points2D:positions")[-1:]
    assert mark[0] == pytest.approx(2.0 / 10.0 * WIDTH, rel=0.01)
    # Another path begins with an empty plot.
    other = flight("s1", path="pear · 0.6 m/s", t_s=60.0)
    path = record(tmp_path / "other.rrd", *flights, other)
    assert column(path, "/tracking/compared/earlier", "LineStrips2D:strips")[-1] == []


def test_the_names_are_ordered_by_error_and_the_one_that_flies_comes_last(tmp_path: Path) -> None:
    events = [
        flight("baseline", late_s=0.2),
        flight("s1", t_s=15.0),
        flight("s2", t_s=30.0, late_s=0.05, samples=200),
    ]
    path = record(tmp_path / "run.rrd", *events)
    rows = names(path).splitlines()
    assert rows[:2] == ["circle · 0.6 m/s", "RMS error [mm]"]
    assert [row.split()[0] for row in rows[2:]] == ["s1", "baseline", "s2"]
    assert rows[2] == f"s1  {LATE_MM:.1f}"
    assert rows[-1].endswith("so far")


def test_the_number_of_entities_does_not_grow_with_the_flights(tmp_path: Path) -> None:
    def drawn(count: int) -> set[str]:
        events = [flight("s1", path=f"drawing-{k}", t_s=3.0 * k, samples=50) for k in range(count)]
        return entities(record(tmp_path / f"{count}.rrd", *events))

    assert drawn(2) == drawn(40)


def test_between_flights_nothing_is_drawn_again(tmp_path: Path) -> None:
    sink = RerunSink.to_file("run-1", tmp_path / "run.rrd")
    sink.write([flight(samples=100)])
    sink.write([taken_back(1.0)])
    for k in range(4):
        sink.write([MessageEvent(2.0 + k, "info", "on its way back to the start")])
    sink.close()
    rows = column(tmp_path / "run.rrd", "/tracking/plot/path/places", "Points2D:positions")
    assert len([row for row in rows if row]) == 1
    trails = column(tmp_path / "run.rrd", "/tracking/plot/path/trail", "LineStrips2D:strips")
    assert len(trails) == 8


def test_a_robot_with_one_axis_shows_its_position_over_time(tmp_path: Path) -> None:
    event = flight(axes=("x",))
    path = record(tmp_path / "run.rrd", event)
    for signal, values in (("desired", event.desired), ("actual", event.actual)):
        times_s, drawn = scalars(path, f"/tracking/{signal}/target")
        all_s = np.arange(len(values)) * SAMPLE_TIME_S
        np.testing.assert_allclose(np.interp(all_s, times_s, drawn), values[:, 0], atol=1e-3)
    assert not any(p.startswith("/tracking/plot") for p in entities(path))


def test_of_robots_that_fly_at_once_one_is_drawn_and_all_errors_are(tmp_path: Path) -> None:
    a, b = flight(robot="a"), flight(robot="b", late_s=0.3)
    both = [part for pair in zip(parts(a, 50), parts(b, 50), strict=True) for part in pair]
    path = record(tmp_path / "run.rrd", *both)
    trails = column(path, "/tracking/plot/path/trail", "LineStrips2D:strips")
    np.testing.assert_allclose(trails[-1][0][-1], a.actual[-1], rtol=1e-6)  # type: ignore[index]
    for robot in "ab":
        assert len(scalars(path, f"/tracking/error/{robot}/s1")[1]) > 100


def test_the_table_tells_by_how_much_each_prior_is_better(tmp_path: Path) -> None:
    events: list[ViewerEvent] = []
    for k, path_name in enumerate(("circle · 0.6 m/s", "circle · 0.9 m/s")):
        t_s = 50.0 * k
        events += [
            flight("baseline", path=path_name, t_s=t_s, late_s=0.2),
            flight("s1", path=path_name, t_s=t_s + 15.0, late_s=0.1),
        ]
    rows = table(record(tmp_path / "run.rrd", *events, taken_back(0.0))).splitlines()
    cells = [[cell.strip() for cell in re.split(r"(?<!\\)\|", row)[1:-1]] for row in rows[2:]]
    assert cells[0] == ["", "baseline", "s1"]
    assert cells[2] == ["circle · 0.6 m/s", f"{2 * LATE_MM:.1f}", f"**{LATE_MM:.1f}**"]
    assert cells[-1] == ["*less than the baseline*", "", "50 %"]


def test_a_study_and_its_flights_share_a_recording_and_its_colours(tmp_path: Path) -> None:
    path = record(tmp_path / "run.rrd", iteration_event(), flight("s2", t_s=20.0))
    estimate = column(path, "/sphere/points/s2", "Points3D:colors")[0]
    trail = column(path, "/tracking/plot/path/trail", "LineStrips2D:colors")[0]
    assert trail == estimate
