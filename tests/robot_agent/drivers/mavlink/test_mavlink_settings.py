"""What a fleet file may say of a MAVLink vehicle, and the sentence for what it may not."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
from mavlink_air import X_AND_Y, settings

from nufleet.robot_agent.drivers.mavlink.driver import DRIVER
from nufleet.robot_agent.drivers.mavlink.settings import MavlinkSettings
from nufleet.shared.errors import FleetFileError
from nufleet.shared.robots.drivers import check_settings, load_driver, settings_of, shared_thing
from nufleet.shared.robots.fleet_file import read_fleet_file, validated_settings

AXIS = '{ name = "x", amplitude_max = 0.4, velocity_max = 0.8, acceleration_max = 2.0 }'
DEEP = {
    "position_max": 1.0,
    "speed_max": 1.0,
    "acceleration_max": 2.0,
    "correction_max": 0.4,
    "correction_speed_max": 0.5,
}


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        (
            {"url": "udp:14540"},
            "'udp:14540' is no address of a vehicle such as `udpin://0.0.0.0:14540`",
        ),
        ({"url": "udpin://0.0.0.0:99999"}, "is no address of a vehicle"),
        ({"url": "serial:///dev/ttyACM0"}, "is no address of a vehicle"),
        ({"profile": "inav"}, "profile: must be 'px4' or 'ardupilot'"),
        ({"system_id": 0}, "system_id: must be greater than or equal to 1"),
        ({"system_id": 245}, "own_system_id: 245 is the vehicle's own system_id"),
        ({"axes": [{**X_AND_Y[0], "name": "north"}]}, "axes.0.name: must be 'x', 'y' or 'z'"),
        ({"axes": [X_AND_Y[0], X_AND_Y[0]]}, "axis names must differ"),
        ({"axes": [{**X_AND_Y[0], "name": "z"}], "height_m": 0.6}, "above the ground must be left"),
        ({"axes": [{**X_AND_Y[0], "name": "z"}], "tracking": DEEP}, "z moves 1.4 m down from"),
        ({"height_m": 20.0}, "height_m: the climb to 20 m takes 45 s within climb_m_s and the"),
        ({"idle_s": None}, "idle_s: must be a valid number"),
        ({"axes": [{**X_AND_Y[0], "output_max": 0.1}]}, "closer to 0 than its amplitude_max"),
        ({"sample_time_s": 1.0}, "sample_time_s: must be less than or equal to 0.25"),
        ({"omega_max_rad_s": 200.0}, "omega_max_rad_s must be below the Nyquist frequency"),
        ({"omega_max_rad_s": 40.0, "telemetry_hz": 5.0}, "cannot tell 40 rad/s"),
        ({"sistem_id": 1}, "sistem_id: unknown"),
    ],
)
def test_a_wrong_setting_is_one_sentence(changes: dict[str, object], says: str) -> None:
    given = {"profile": "px4", "url": "udpin://0.0.0.0:14540", "axes": X_AND_Y, **changes}
    with pytest.raises(FleetFileError) as caught:
        validated_settings(MavlinkSettings, Path("lab.toml"), "drone", given)
    assert says in str(caught.value)
    assert "\n" not in str(caught.value)


def test_the_limits_of_the_fleet_file_are_those_of_the_robot() -> None:
    fenced = [{**X_AND_Y[0], "output_min": -0.8, "output_max": 0.9}]
    spec = settings(axes=fenced, kind="my-quad", idle_s=7.0).spec
    assert (spec.kind, spec.simulated, spec.idle_s) == ("my-quad", False, 7.0)
    assert (spec.axis("x").output_min, spec.axis("x").output_max) == (-0.8, 0.9)


def test_an_axis_without_a_fence_has_one_of_three_times_its_largest_reference() -> None:
    axis = settings().spec.axis("x")
    assert (axis.output_min, axis.output_max) == (-1.5, 1.5)
    axis = settings(tracking=DEEP).spec.axis("x")
    assert (axis.output_min, axis.output_max) == pytest.approx((-4.2, 4.2))


def test_the_fleet_files_of_the_documentation_are_accepted(tmp_path: Path) -> None:
    page = (Path(__file__).parents[4] / "docs" / "real-robots.md").read_text(encoding="utf-8")
    files = [block for block in re.findall(r"```toml\n(.*?)```", page, re.S) if "mavlink" in block]
    assert len(files) == 2
    for text in files:
        path = tmp_path / "lab.toml"
        path.write_text(text)
        check_settings(read_fleet_file(path), path)


def test_robots_on_one_port_share_a_process_and_must_be_different_systems(tmp_path: Path) -> None:
    assert load_driver("mavlink") is DRIVER
    one, two = settings(), settings(system_id=2)
    shared = {shared_thing(DRIVER, lambda own=own: own) for own in (one, two)}
    assert shared == {"udpin://127.0.0.1:14540"}
    rng = np.random.default_rng(0)
    assert set(DRIVER.build({"a": one, "b": two}, rng)) == {"a", "b"}
    table = 'driver = "mavlink"\n[robots.{0}.settings]\nprofile = "px4"\n{1}\n'
    own = 'url = "udpin://127.0.0.1:14540"\naxes = [' + AXIS + "]"
    path = tmp_path / "lab.toml"
    robots = "".join(f"[robots.{name}]\n" + table.format(name, own) for name in ("a", "b"))
    path.write_text(f'schema = 1\nname = "lab"\n{robots}')
    with pytest.raises(FleetFileError, match=r"same address, system 1 at udpin://127.0.0.1:14540"):
        settings_of(read_fleet_file(path), path, ["b"], DRIVER)
