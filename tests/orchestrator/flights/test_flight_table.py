"""Every sample of every flight is in the table, which is complete however the flights ended."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from flown_paths import STEP_S, flight, line

from nufleet.orchestrator.flights.table import FLIGHTS, FlightTable

COLUMNS = [
    *("robot", "flight", "axis", "sample", "t_s", "desired", "reference", "actual"),
    *("prior", "mean", "variance", "share", "weights"),
]


def test_each_sample_of_each_axis_is_one_row_as_it_was_flown(tmp_path: Path) -> None:
    desired = line(5, 2)
    flown = flight(desired, desired + 0.1)
    FlightTable(tmp_path).write(flown, ("x", "y"))
    rows = pq.read_table(tmp_path / FLIGHTS)
    assert rows.column_names == COLUMNS
    assert len(rows) == 10
    for column, axis in enumerate(("x", "y")):
        mine = [row for row in rows.to_pylist() if row["axis"] == axis]
        assert {(row["robot"], row["flight"]) for row in mine} == {("target", flown.label)}
        assert [row["sample"] for row in mine] == list(range(5))
        np.testing.assert_allclose([row["t_s"] for row in mine], np.arange(5) * STEP_S)
        details = flown.details
        for name, expected in (
            ("desired", desired[:, column]),
            ("reference", flown.reference[:, column]),
            ("actual", flown.actual[:, column]),
            ("prior", details.prior[:, column]),
            ("mean", details.mean[:, column]),
            ("variance", details.variance[:, column]),
            ("share", details.share),
        ):
            np.testing.assert_array_equal([row[name] for row in mine], expected)


def test_the_weights_of_a_mixture_are_in_every_row_by_source(tmp_path: Path) -> None:
    single = flight(line(2, 2), line(2, 2))
    weights = np.array([[0.5, 0.3, 0.2], [0.7, 0.2, 0.1], [0.9, 0.1, 0.0]])
    mixed = flight(line(3, 2), line(3, 2))
    details = mixed.details.model_copy(update={"experts": ("a", "b"), "weights": weights})
    table = FlightTable(tmp_path)
    table.write(single, ("x", "y"))
    table.write(replace(mixed, details=details), ("x", "y"))
    rows = pq.read_table(tmp_path / FLIGHTS)["weights"].to_pylist()
    expected = [list(zip(("a", "b", "none"), row, strict=True)) for row in weights.tolist()]
    assert rows == [None] * 4 + expected + expected


def test_flights_follow_one_another(tmp_path: Path) -> None:
    for k in range(3):  # a run that is resumed goes on with the table that it finds
        again = flight(line(4 + k, 1), line(4 + k, 1), label=f"flight {k}")
        FlightTable(tmp_path).write(again, ("x",))
    rows = pq.read_table(tmp_path / FLIGHTS)
    assert rows["flight"].to_pylist() == ["flight 0"] * 4 + ["flight 1"] * 5 + ["flight 2"] * 6


@pytest.mark.parametrize("place", [0, 1])
def test_a_flight_without_samples_takes_no_row_and_spoils_nothing(
    tmp_path: Path, place: int
) -> None:
    """A robot that fails on its way to the start flew nothing of its path."""
    nothing = np.empty((0, 2))
    flights = [flight(line(3, 2), line(3, 2))]
    flights.insert(place, flight(nothing, nothing, failure="it fell over"))
    for one in flights:
        FlightTable(tmp_path).write(one, ("x", "y"))
    assert len(pq.read_table(tmp_path / FLIGHTS)) == 6


def test_a_file_that_was_cut_off_spoils_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    table = FlightTable(tmp_path)
    table.write(flight(line(3, 1), line(3, 1)), ("x",))
    write_table = pq.write_table

    def killed(rows: pa.Table, part: Path, **options: str) -> None:
        write_table(rows, part, **options)
        part.write_bytes(part.read_bytes()[:100])
        raise KeyboardInterrupt

    monkeypatch.setattr(pq, "write_table", killed)
    with pytest.raises(KeyboardInterrupt):
        table.write(flight(line(5, 1), line(5, 1)), ("x",))
    assert len(pq.read_table(tmp_path / FLIGHTS)) == 3


def test_without_a_flight_there_is_no_table(tmp_path: Path) -> None:
    nothing = np.empty((0, 2))
    FlightTable(tmp_path).write(flight(nothing, nothing, failure="it fell over"), ("x", "y"))
    assert not (tmp_path / FLIGHTS).exists()
