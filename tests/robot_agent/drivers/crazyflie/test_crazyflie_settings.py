"""A Crazyflie in a fleet file: what is wrong with it is said before anything is opened."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from nufleet.robot_agent.drivers.crazyflie.driver import DRIVER
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings, spec_of
from nufleet.robot_agent.serve import build_robots
from nufleet.shared.errors import FleetFileError, InvalidInputError
from nufleet.shared.robots.drivers import check_settings, shared_thing
from nufleet.shared.robots.fleet_file import read_fleet_file
from nufleet.shared.strict import describe_validation

RADIO = "radio://0/80/2M/E7E7E7E701"


def wrong(settings: Mapping[str, Any]) -> str:
    with pytest.raises(ValidationError) as raised:
        CrazyflieSettings.model_validate({"uri": RADIO, **settings})
    return describe_validation(raised.value)


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("E7E7E7E701", "must be like radio://0/80/2M/E7E7E7E7E7"),
        ("bluetooth://0", "must be like radio://0/80/2M/E7E7E7E7E7"),
        ("radio://0/126/2M", "channel 126 is above 125"),
        ("radio://0/eighty/2M", "'eighty' is no channel"),
        ("radio://0/80/3M", "'3M' is no data rate"),
        ("radio://0/80/2M/E7E7E7E7E7E7", "is no address: up to ten hexadecimal digits"),
        ("radio://0/80/2M/E7/1", "has more than four parts"),
        ("radio://dongle/80", "'dongle' is no dongle"),
        ("radio://0/80/2M?safelink=0", "'safelink=0' is no option of a radio"),
        ("udp://127.0.0.1", "must be like udp://192.168.43.42:5000"),
        ("tcp://host:port", "must be like tcp://192.168.43.42:5000"),
        ("usb://", "must be like usb://0"),
    ],
)
def test_an_address_that_cannot_be_one_is_refused(uri: str, says: str) -> None:
    assert f"uri: {says}" in wrong({"uri": uri}) or says in wrong({"uri": uri})


@pytest.mark.parametrize(
    ("settings", "says"),
    [
        ({"axes": ("x", "x")}, "axes must differ, got x, x"),
        ({"log_period_s": 0.015}, "0.015 s is no multiple of 0.01 s"),
        ({"log_period_s": 0.05}, "longer than sample_time_s 0.02 s: not every sample"),
        ({"origin_m": (0.0, 0.0, 0.2)}, "it would touch the ground"),
        (
            {"axes": ("x", "z")},
            "0.5 m high, and it may come 1 m lower (tracking.position_max + track",
        ),
        ({"estimator": "ukf"}, "estimator: must be 'complementary' or 'kalman'"),
        (
            {"estimator": None, "start": {"position_m": (0.0, 0.0, 0.0)}},
            "start is told to the estimator kalman alone",
        ),
        ({"omega_max_rad_s": 200.0}, "below the Nyquist frequency"),
        ({"limits": {"amplitude_m": 2.0}}, "closer to 0 than its amplitude_max 2 m"),
        ({"limits": {"fence_m": 0.5}}, "lies outside limits.fence_m 0.5 m"),
        ({"battery": {"empty_v": 4.5}}, "empty_v 4.5 V must be below full_v 4.1 V"),
        ({"motion_capture": {"system": "vicon", "hostname": ""}}, "body: missing"),
        ({"altitude_m": 1.0}, "altitude_m: unknown"),
    ],
)
def test_settings_that_contradict_each_other_are_refused(
    settings: dict[str, Any], says: str
) -> None:
    assert says in wrong(settings)


def test_the_spec_is_that_of_a_real_robot_with_a_fence_that_lands_when_it_idles() -> None:
    spec = spec_of(CrazyflieSettings(uri=RADIO, axes=("x", "z"), origin_m=(0.0, 1.0, 1.2)))
    assert [axis.name for axis in spec.axes] == ["x", "z"]
    assert {(axis.output_min, axis.output_max) for axis in spec.axes} == {(-1.0, 1.0)}
    assert (spec.simulated, spec.idle_s, spec.measurement) == (False, 15.0, "crazyflie-log")


def test_drones_share_a_process_with_those_on_the_same_radio_alone() -> None:
    uris = (RADIO, "radio://0/80/2M/E7E7E7E702", "radio://1/90/2M", "udp://127.0.0.1:19850")
    found = [shared_thing(DRIVER, lambda uri=uri: CrazyflieSettings(uri=uri)) for uri in uris]
    assert found == ["Crazyradio 0", "Crazyradio 0", "Crazyradio 1", None]


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (RADIO, "radio://1/80/2M/e7e7e7e701"),
        ("radio://0/2", "radio://0/2/2M/E7E7E7E7E7?rate_limit=50"),
        ("udp://127.0.0.1:19850", "udp://127.0.0.1:19850/"),
    ],
)
def test_two_drones_with_one_address_are_refused_whichever_of_them_is_asked_for(
    tmp_path: Path, first: str, second: str
) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        'schema = 1\nname = "lab"\n'
        f'[robots.a]\ndriver = "crazyflie"\nsettings = {{ uri = "{first}" }}\n'
        f'[robots.b]\ndriver = "crazyflie"\nsettings = {{ uri = "{second}" }}\n'
    )
    fleet = read_fleet_file(path)
    for use in (
        lambda: check_settings(fleet, path),
        lambda: build_robots(fleet, path, ("a",)),
        lambda: build_robots(fleet, path, ("b",)),
    ):
        with pytest.raises(FleetFileError, match="have the same address"):
            use()


def test_without_cflib_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("nufleet.shared.robots.drivers.find_spec", lambda _: None)
    with pytest.raises(InvalidInputError, match=r"pip install 'nufleet\[crazyflie\]'"):
        DRIVER.build({}, np.random.default_rng(0))
