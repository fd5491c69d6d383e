"""The flights of an evaluation are kept as they come, and a person learns how many are left."""

from __future__ import annotations

from pathlib import Path

import pytest
from evaluated_flights import ERRORS, records

from nufleet.orchestrator.evaluation.kept_records import RECORDS, KeptRecords, read_records
from nufleet.orchestrator.evaluation.results import FlightRecord

FLIGHTS = records(ERRORS)


def kept(folder: Path) -> list[FlightRecord]:
    lines = (folder / RECORDS).read_text(encoding="utf-8").splitlines()
    return [FlightRecord.model_validate_json(line) for line in lines]


def interrupted(folder: Path) -> None:
    with KeptRecords(folder, 10, say=lambda line: None, on_point=lambda records: None) as log:
        for flight in FLIGHTS[:3]:
            log.flown(flight)
            assert kept(folder)[-1] == flight
        raise KeyboardInterrupt


def test_whatever_was_flown_before_an_interruption_is_kept(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path)
    assert kept(tmp_path) == FLIGHTS[:3]


def test_a_record_that_was_cut_off_is_not_kept(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        interrupted(tmp_path)
    with (tmp_path / RECORDS).open("a", encoding="utf-8") as file:
        file.write('{"target": "tar')
    assert read_records(tmp_path) == FLIGHTS[:3]
    with KeptRecords(tmp_path, 10, 3, say=lambda line: None, on_point=lambda records: None) as log:
        log.flown(FLIGHTS[3])
    assert read_records(tmp_path) == FLIGHTS[:4]


def test_flights_are_announced_with_the_time_that_is_left(tmp_path: Path) -> None:
    said: list[str] = []
    now_s = 0.0
    with KeptRecords(
        tmp_path, 40, 2, say=said.append, on_point=lambda records: None, clock=lambda: now_s
    ) as log:
        log.begins("clover · 0.6 m/s", 2)
        for flight in FLIGHTS[:2]:
            log.flown(flight)
        now_s = 20.0
        log.begins("clover · 0.6 m/s after 15 s of its own flying", 1)
    assert said == [
        "[bold]clover · 0.6 m/s[/]: flights 3 to 4 of 40",
        "[bold]clover · 0.6 m/s after 15 s of its own flying[/]: flight 5 of 40, about 6 min left",
    ]
