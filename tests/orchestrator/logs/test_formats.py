"""Logs of every format give the numbers that were written, with the times that belong to them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from log_files import (
    BEGAN_S,
    Flown,
    flown,
    write_dataflash,
    write_mcap,
    write_rosbag,
    write_table,
    write_tlog,
    write_ulog,
)

from nufleet.orchestrator.logs import formats, signals, table
from nufleet.orchestrator.logs.formats import format_of, list_channels, read_signals
from nufleet.orchestrator.logs.signals import LogError, Signal, SignalNames


@pytest.fixture(scope="module")
def flight() -> Flown:
    return flown(4.0)


def assert_is(
    found: tuple[Signal, Signal], flight: Flown, *, began_s: float = 0.0, exact: float = 1e-12
) -> None:
    for signal, expected in zip(found, (flight.reference, flight.output), strict=True):
        np.testing.assert_allclose(signal.value, expected, atol=exact)
        np.testing.assert_allclose(signal.time_s, began_s + flight.time_s, atol=2e-6)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_rosbag_is_read_by_the_stamps_of_its_headers(
    tmp_path: Path, flight: Flown, storage: str
) -> None:
    bag = tmp_path / "bag"
    write_rosbag(bag, flight, storage=storage)
    names = "/cmd.pose.position.x", "/odom.pose.pose.position.x"
    found = read_signals(bag, "x", *names)
    assert_is(found, flight, began_s=BEGAN_S)
    assert {signal.clock for signal in found} == {"device"}
    offered = [channel.name for channel in list_channels(bag)]
    assert set(names) <= set(offered)
    assert "/odom.pose.covariance[35]" not in offered


def test_a_single_mcap_file_without_headers_has_the_times_of_its_receipt(
    tmp_path: Path, flight: Flown
) -> None:
    log = tmp_path / "flight.mcap"
    write_mcap(log, flight)
    found = read_signals(log, "x", "/setpoint.x", "/position.x")
    assert_is(found, flight, began_s=BEGAN_S)
    assert {signal.clock for signal in found} == {"receipt"}


@pytest.mark.parametrize("setpoint", ["trajectory_setpoint", "vehicle_local_position_setpoint"])
def test_a_px4_log_is_read_without_naming_its_signals(
    tmp_path: Path, flight: Flown, setpoint: str
) -> None:
    log = tmp_path / "flight.ulg"
    write_ulog(log, flight, setpoint=setpoint)
    assert_is(read_signals(log, "x"), flight, began_s=5.0, exact=1e-6)
    assert "vehicle_local_position.x" in {channel.name for channel in list_channels(log)}


def test_an_ardupilot_log_is_read_without_naming_its_signals(tmp_path: Path, flight: Flown) -> None:
    log = tmp_path / "flight.bin"
    write_dataflash(log, flight)
    assert_is(read_signals(log, "x"), flight, began_s=3.0, exact=1e-6)
    assert {"PSCN.TPN", "PSCN.PN"} <= {channel.name for channel in list_channels(log)}


def test_a_telemetry_log_has_the_times_of_the_device_not_those_of_the_radio(
    tmp_path: Path, flight: Flown
) -> None:
    log = tmp_path / "flight.tlog"
    write_tlog(log, flight)
    found = read_signals(log, "x")
    assert_is(found, flight, began_s=3.0, exact=1e-6)
    assert {signal.clock for signal in found} == {"device"}


@pytest.mark.parametrize(
    ("separator", "decimal", "time"),
    [(",", ".", "time_s"), (";", ",", "time_s"), ("\t", ".", "time_ms"), (";", ".", "t")],
)
def test_a_table_may_be_that_of_another_country(
    tmp_path: Path, flight: Flown, separator: str, decimal: str, time: str
) -> None:
    log = tmp_path / "flight.csv"
    write_table(log, flight, separator=separator, decimal=decimal, time=time)
    assert_is(read_signals(log, "x"), flight, exact=1e-8)


def test_a_cfclient_table_needs_the_unit_of_its_times(tmp_path: Path, flight: Flown) -> None:
    log = tmp_path / "flight.csv"
    write_table(log, flight, time="ms")
    log.write_text(log.read_text().replace("ms,", "Timestamp,", 1))
    with pytest.raises(LogError, match="--time Timestamp:ms"):
        read_signals(log, "x")
    assert_is(read_signals(log, "x", time="Timestamp:ms"), flight, exact=1e-8)


def test_numbers_with_decimal_commas_between_commas_are_an_error_that_says_so(
    tmp_path: Path, flight: Flown
) -> None:
    log = tmp_path / "flight.csv"
    write_table(log, flight, decimal=",")
    with pytest.raises(LogError, match=r"line 2: 6 columns.*decimal commas need semicolons"):
        read_signals(log, "x")


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is empty"),
        (b"\n", "first line must name the columns"),
        (b"1,2,3\n4,5,6\n", "first line must name the columns"),
        (b"time_s,reference_x,reference_x\n", "names reference_x twice"),
        (b"time_s,reference_x,output_x\n0,1,two\n", "line 2: expected a number, got 'two'"),
        (b"time_s,reference_x,output_x\n0,1,2\n", "expected 2 to"),
        (b"time_s,reference_x,output_x\n0,1\n", "line 2: 2 columns, and the first line names 3"),
        (b"time_s,reference_x,y\n0,1,2\n", "holds no signal"),
        (b"\x00\xff\xfe" * 50_000, "table"),
        (b"a" * 200_000, "longer than"),
    ],
)
def test_what_is_no_such_table_is_an_error_that_names_the_line(
    tmp_path: Path, content: bytes, said: str
) -> None:
    log = tmp_path / "flight.csv"
    log.write_bytes(content)
    with pytest.raises(LogError, match=said):
        read_signals(log, "x")


@pytest.mark.parametrize("ending", ["ulg", "bin", "tlog", "mcap", "db3"])
@pytest.mark.parametrize("content", [b"", b"no log at all", bytes(range(256)) * 40])
def test_a_damaged_log_is_an_error_that_names_the_file_and_leaves_stdout_alone(
    tmp_path: Path, ending: str, content: bytes, capfd: pytest.CaptureFixture[str]
) -> None:
    log = tmp_path / f"flight.{ending}"
    log.write_bytes(content)
    with pytest.raises(LogError, match=r"flight\."):
        read_signals(log, "x", "A.b", "C.d")
    assert capfd.readouterr().out == ""


@pytest.mark.parametrize("ending", ["ulg", "bin", "tlog", "mcap"])
def test_a_log_that_breaks_off_is_read_to_there_or_refused(
    tmp_path: Path, flight: Flown, ending: str
) -> None:
    log = tmp_path / f"flight.{ending}"
    writers = {"ulg": write_ulog, "bin": write_dataflash, "tlog": write_tlog, "mcap": write_mcap}
    writers[ending](log, flight)
    log.write_bytes(log.read_bytes()[: log.stat().st_size * 2 // 3])
    names = ("/setpoint.x", "/position.x") if ending == "mcap" else (None, None)
    try:
        reference, _ = read_signals(log, "x", *names)
    except LogError:
        return
    np.testing.assert_allclose(reference.value, flight.reference[: len(reference.value)], atol=1e-6)


def test_a_signal_that_is_not_there_is_named_with_those_that_are_near(
    tmp_path: Path, flight: Flown
) -> None:
    log = tmp_path / "flight.ulg"
    write_ulog(log, flight)
    with pytest.raises(LogError, match=r"no signal vehicle_local_position\.xx; nearest"):
        read_signals(log, "x", output="vehicle_local_position.xx")
    bag = tmp_path / "bag"
    write_rosbag(bag, flight, storage="mcap")
    with pytest.raises(LogError, match=r"nearest to it is /cmd\.pose\.position"):
        read_signals(bag, "x", "/cmd.pose.position.w", "/odom.pose.pose.position.x")


def test_a_format_without_usual_signals_asks_for_them(tmp_path: Path, flight: Flown) -> None:
    bag = tmp_path / "bag"
    write_rosbag(bag, flight, storage="mcap")
    with pytest.raises(LogError, match="name them with --reference and --output"):
        read_signals(bag, "x")


def test_a_file_of_unknown_kind_and_one_that_is_not_there_are_refused(tmp_path: Path) -> None:
    with pytest.raises(LogError, match=r"ends with \.mcap"):
        format_of(tmp_path / "flight.docx")
    with pytest.raises(LogError, match="No such file"):
        read_signals(tmp_path / "flight.csv", "x")


def test_sizes_are_checked_before_anything_is_read(
    tmp_path: Path, flight: Flown, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = tmp_path / "flight.csv"
    write_table(log, flight)
    monkeypatch.setattr(signals, "FILE_BYTES_MAX", 100)
    with pytest.raises(LogError, match="more than"):
        read_signals(log, "x")
    monkeypatch.undo()
    monkeypatch.setattr(signals, "SAMPLES_MAX", 150)
    with pytest.raises(LogError, match="more than 150 samples"):
        table.read(log, ["output_x"], None)


def test_a_missing_library_is_named_with_its_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(formats, "find_spec", lambda name: None)
    with pytest.raises(LogError, match=r"pip install 'nufleet\[logs\]'"):
        format_of(tmp_path / "flight.ulg")


def test_reference_and_output_must_be_two_signals() -> None:
    with pytest.raises(ValueError, match="the same signal"):
        SignalNames(reference="a.x", output="a.x")
