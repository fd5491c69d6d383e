"""`nufleet import`: a flight that exists becomes a response of its robot, once."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import NoReturn

import numpy as np
import pytest
from click.testing import CliRunner, Result
from log_files import (
    Flown,
    flown,
    write_dataflash,
    write_mcap,
    write_rosbag,
    write_table,
    write_tlog,
    write_ulog,
)

from nufleet.orchestrator.cli.import_flight import import_flight
from nufleet.orchestrator.fleet.reach import FleetChoice
from nufleet.orchestrator.flights.pilot import PathFlight
from nufleet.orchestrator.jobs.import_flight import ImportCommand, import_log
from nufleet.orchestrator.logs.keeping import keep_flight_responses
from nufleet.orchestrator.logs.signals import LogError
from nufleet.orchestrator.repository.address import default_url
from nufleet.orchestrator.repository.records import Origin, ResponseRecord, RobotRecord
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.shared.errors import InvalidInputError, NoRouterError
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire.messages import Description
from nufleet.shared.wire.motions import TrackingDetails

SPEC = RobotSpec(
    kind="logged",
    axes=tuple(
        AxisSpec(name=name, unit="m", amplitude_max=1.0, velocity_max=1.0, acceleration_max=4.0)
        for name in ("x", "y")
    ),
    sample_time_s=0.02,
    omega_min_rad_s=0.1,
    omega_max_rad_s=5.4,
    duration_max_s=600.0,
    settling_time_s=5.0,
    simulated=False,
)
ROBOT = Description(robot="drone", boot_id="boot-1", spec=SPEC)
COMMAND = ImportCommand(
    log=Path("log"),
    robot="drone",
    axis="x",
    reference=None,
    output=None,
    time=None,
    begin_s=0.0,
    end_s=None,
    fleet_file=None,
    connect="tcp/127.0.0.1:1",
    fleet_name="lab",
    runs_root=Path("runs"),
    repository=None,
    as_json=False,
)


@pytest.fixture(scope="module")
def flight() -> Flown:
    return flown(30.0)


@pytest.fixture
def repository(tmp_path: Path) -> Iterator[Repository]:
    with open_repository(f"{tmp_path}/nufleet.sqlite") as opened:
        yield opened


def stored(repository: Repository, axis: str = "x") -> tuple[ResponseRecord, ...]:
    return repository.flights.responses("lab", "drone", axis)


def assert_true(record: ResponseRecord, flight: Flown) -> None:
    response = record.response
    away = np.abs(response.z - flight.response(response.omega_rad_s)) ** 2 / response.variance
    assert float(np.mean(away)) < 2.0
    assert len(away) > 12


def test_the_same_flight_in_every_format_is_the_same_response(
    tmp_path: Path, flight: Flown, repository: Repository
) -> None:
    write_rosbag(tmp_path / "bag", flight, storage="mcap")
    write_mcap(tmp_path / "a.mcap", flight)
    write_ulog(tmp_path / "a.ulg", flight)
    write_dataflash(tmp_path / "a.bin", flight)
    write_tlog(tmp_path / "a.tlog", flight)
    write_table(tmp_path / "a.csv", flight)
    names = {
        "bag": ("/cmd.pose.position.x", "/odom.pose.pose.position.x"),
        "a.mcap": ("/setpoint.x", "/position.x"),
    }
    found = []
    for name in ("bag", "a.mcap", "a.ulg", "a.bin", "a.tlog", "a.csv"):
        reference, output = names.get(name, (None, None))
        command = replace(COMMAND, log=tmp_path / name, reference=reference, output=output)
        result = import_log(command, repository, "lab", ROBOT)
        assert result.new or found
        found.append(repository.studies.response(result.response))
    for record in found:
        assert_true(record, flight)
        assert record.origin is Origin.LOG
        np.testing.assert_allclose(record.response.z, found[0].response.z, atol=0.01)


def test_what_is_stored_says_where_it_came_from_and_what_it_is_valid_for(
    tmp_path: Path, flight: Flown, repository: Repository
) -> None:
    log = tmp_path / "morning.csv"
    write_table(log, flight)
    result = import_log(replace(COMMAND, log=log), repository, "lab", ROBOT)
    (record,) = stored(repository)
    assert record.study_id == "morning.csv"
    assert record.kind == "logged"
    assert record.flown is not None
    assert record.flown.spec == SPEC
    assert record.flown.band_rad_s == result.band_rad_s
    assert record.flown.flight.noise_std == pytest.approx(0.002, rel=0.5)
    speed = np.max(np.abs(flight.reference[10:] - flight.reference[:-10])) / 0.2
    assert record.flown.flight.speed == pytest.approx(speed)
    assert record.response.amplitude == pytest.approx(np.ptp(flight.reference) / 2)


def test_a_log_is_stored_once(tmp_path: Path, flight: Flown, repository: Repository) -> None:
    log = tmp_path / "a.csv"
    write_table(log, flight)
    first = import_log(replace(COMMAND, log=log), repository, "lab", ROBOT)
    again = import_log(replace(COMMAND, log=log), repository, "lab", ROBOT)
    assert (first.new, again.new) == (True, False)
    assert len(stored(repository)) == 1


def test_a_reference_that_lags_its_output_is_refused_and_nothing_is_stored(
    tmp_path: Path, flight: Flown, repository: Repository
) -> None:
    log = tmp_path / "a.csv"
    write_table(log, flight)
    exchanged = replace(COMMAND, log=log, reference="output_x", output="reference_x")
    with pytest.raises(LogError, match="drone, axis x: the output moves before its reference"):
        import_log(exchanged, repository, "lab", ROBOT)
    assert stored(repository) == ()


def test_an_output_that_is_cut_off_is_refused(
    tmp_path: Path, flight: Flown, repository: Repository
) -> None:
    log = tmp_path / "a.csv"
    write_table(log, replace(flight, output=np.clip(flight.output, -0.1, 0.1)))
    with pytest.raises(LogError, match=r"cut off at -0\.1 and 0\.1"):
        import_log(replace(COMMAND, log=log), repository, "lab", ROBOT)


def test_a_log_too_short_for_its_robot_says_how_long_it_should_be(
    tmp_path: Path, flight: Flown, repository: Repository
) -> None:
    log = tmp_path / "a.csv"
    write_table(log, flight)
    slow = ROBOT.model_copy(update={"spec": SPEC.model_copy(update={"settling_time_s": 60.0})})
    with pytest.raises(LogError, match="at least 48 s are needed"):
        import_log(replace(COMMAND, log=log), repository, "lab", slow)


def test_an_axis_that_the_robot_lacks_and_trims_the_wrong_way_round_are_refused(
    tmp_path: Path, repository: Repository
) -> None:
    with pytest.raises(InvalidInputError, match="no axis z: choose one of x, y"):
        import_log(replace(COMMAND, axis="z"), repository, "lab", ROBOT)
    with pytest.raises(InvalidInputError, match="--to 3 must be later than --from 5"):
        import_log(replace(COMMAND, begin_s=5.0, end_s=3.0), repository, "lab", ROBOT)


def test_without_a_router_a_robot_is_that_of_the_only_fleet_in_the_repository_which_has_it(
    tmp_path: Path, flight: Flown, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "a.csv"
    write_table(log, flight)
    options = ["--robot", "drone", "--runs", str(tmp_path), "--json"]

    def unanswered(*_: object) -> NoReturn:
        raise NoRouterError("no router answers")

    monkeypatch.setattr(FleetChoice, "connection", unanswered)

    def imported(*fleets: str) -> Result:
        with open_repository(default_url(tmp_path)) as repository:
            for fleet in fleets:
                repository.robots.describe(RobotRecord(fleet, "drone", SPEC, "boot-1"))
        return CliRunner().invoke(import_flight, [str(log), *options])

    assert isinstance(imported().exception, NoRouterError)
    found = imported("lab")
    assert found.exit_code == 0, found.output
    assert json.loads(found.stdout)["fleet"] == "lab"
    assert "fleets lab, yard, and none of them runs: name one" in str(imported("yard").exception)


def test_the_command_imports_for_a_robot_of_the_repository(tmp_path: Path, flight: Flown) -> None:
    log = tmp_path / "a.csv"
    write_table(log, flight)
    with open_repository(default_url(tmp_path)) as repository:
        repository.robots.describe(RobotRecord("lab", "drone", SPEC, "boot-1"))
    options = ["--robot", "drone", "--fleet-name", "lab", "--runs", str(tmp_path), "--json"]
    done = CliRunner().invoke(import_flight, [str(log), *options], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    document = json.loads(done.stdout)
    assert (document["robot"], document["axis"], document["new"]) == ("drone", "x", True)
    assert "counts it as evidence" in done.stderr
    listed = CliRunner().invoke(import_flight, [str(log), "--list"], catch_exceptions=False)
    assert listed.stdout.split() == ["time_s", "reference_x", "output_x"]
    in_words = CliRunner().invoke(import_flight, [str(log), *options[:-1]], catch_exceptions=False)
    assert "this flight is stored already" in in_words.stdout
    assert " ms ± 0 ms, 0 gaps" in in_words.stdout
    unnamed = CliRunner().invoke(import_flight, [str(log)])
    assert unnamed.exit_code == 2
    assert "--robot" in unnamed.stderr


def test_a_log_that_cannot_be_read_is_refused_before_a_router_is_looked_for(tmp_path: Path) -> None:
    (tmp_path / "damaged.csv").write_text("")
    options = ("--robot", "drone", "--runs", str(tmp_path))
    for name in ("missing.csv", "damaged.csv", "a.jpg"):
        done = CliRunner().invoke(import_flight, [str(tmp_path / name), *options])
        assert isinstance(done.exception, LogError)
        assert name in str(done.exception)


def path_flight(flight: Flown, *, failure: str | None = None) -> PathFlight:
    both = np.stack([flight.reference, np.zeros_like(flight.reference)], axis=1)
    actual = np.stack([flight.output, np.zeros_like(flight.output)], axis=1)
    one = np.zeros(len(both))
    details = TrackingDetails(
        desired=both,
        prior=np.zeros_like(both),
        mean=np.zeros_like(both),
        variance=np.zeros_like(both),
        share=one,
        limited=one,
        step_time_s=one,
        dropped_pairs=0,
        taken_back=None,
    )
    return PathFlight("drone", "clover @ 0.6 m/s", 0.02, both, actual, details, failure)


def test_a_flight_along_a_path_gives_a_response_of_each_axis_that_moved(
    flight: Flown, repository: Repository
) -> None:
    (kept,) = keep_flight_responses(repository, "lab", ROBOT, path_flight(flight), "run-7")
    (record,) = stored(repository)
    assert record.goal_id == kept.goal_id
    assert (record.axis, record.origin) == ("x", Origin.FLIGHT)
    assert record.study_id == "run-7: clover @ 0.6 m/s"
    assert_true(record, flight)
    assert stored(repository, "y") == ()


def test_a_flight_that_was_not_finished_says_nothing_about_its_robot(
    flight: Flown, repository: Repository
) -> None:
    broken = path_flight(flight, failure="it left the workspace")
    assert keep_flight_responses(repository, "lab", ROBOT, broken, "run-7") == ()
    assert stored(repository) == ()
