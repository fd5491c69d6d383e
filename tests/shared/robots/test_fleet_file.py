"""Fleet files: what is written is what is read, and a mistake is named with its place."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nufleet.shared.errors import FleetFileError, InvalidInputError
from nufleet.shared.robots.fleet_file import find_fleet_file, read_fleet_file, validated_settings
from nufleet.shared.strict import Positive, Strict

GOOD = """
schema = 1
name = "lab"
description = "two of them"
seed = 7

[study]
target = "b"
band_rad_s = [0.5, 8.0]

[robots.a]
driver = "double_integrator"
settings = { alpha = 0.85, gains = [1, 2.5], label = "x" }

[robots.b]
driver = "quadrotor"
"""


def written(tmp_path: Path, text: str | bytes) -> Path:
    path = tmp_path / "fleet.toml"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return path


def complaint(tmp_path: Path, text: str | bytes) -> str:
    path = written(tmp_path, text)
    with pytest.raises(FleetFileError) as raised:
        read_fleet_file(path)
    assert isinstance(raised.value, InvalidInputError)
    assert str(raised.value).startswith(f"{path}: ")
    return str(raised.value)


def test_a_fleet_file_is_read_as_written(tmp_path: Path) -> None:
    fleet = read_fleet_file(written(tmp_path, GOOD))
    assert (fleet.name, fleet.description, fleet.seed) == ("lab", "two of them", 7)
    assert list(fleet.robots) == ["a", "b"]
    assert fleet.robots["a"].driver == "double_integrator"
    assert fleet.robots["a"].settings == {"alpha": 0.85, "gains": [1, 2.5], "label": "x"}
    assert fleet.robots["b"].settings == {}
    assert fleet.study is not None
    assert fleet.study.target == "b"
    assert fleet.study.band_rad_s == (0.5, 8.0)


def test_robots_keep_the_order_of_the_file(tmp_path: Path) -> None:
    names = [f"r{k}" for k in (5, 3, 9, 1)]
    robots = "".join(f'[robots.{name}]\ndriver = "d"\n' for name in names)
    fleet = read_fleet_file(written(tmp_path, f'schema = 1\nname = "lab"\n{robots}'))
    assert list(fleet.robots) == names


@pytest.mark.parametrize(
    ("right", "wrong", "named"),
    [
        ("schema = 1", "schema = 2", ("schema", "1")),
        ("schema = 1", "", ("schema", "missing")),
        ("schema = 1", "schema_version = 1", ("schema_version", "unknown")),
        ('name = "lab"', 'nam = "lab"', ("nam:", "unknown")),
        ('name = "lab"', 'name = "My Lab"', ("name", "must consist of lower-case letters")),
        ("seed = 7", 'seed = "7"', ("seed", "valid integer")),
        ("seed = 7", "seed = -7", ("seed", "greater than or equal to 0")),
        ("seed = 7", "seed = 7.5", ("seed", "valid integer")),
        ("[robots.b]", "[robots.B]", ("robots.B", "must consist of lower-case letters")),
        ("[robots.b]", '[robots."b/c"]', ("robots.b/c", "must consist of lower-case letters")),
        ('driver = "quadrotor"', 'drvier = "quadrotor"', ("robots.b.drvier", "unknown")),
        ('driver = "quadrotor"', 'driver = "os.system"', ("robots.b.driver", "match pattern")),
        ('driver = "quadrotor"', "driver = 3", ("robots.b.driver", "valid string")),
        ("settings = {", "setings = {", ("robots.a.setings", "unknown")),
        ("band_rad_s = [0.5, 8.0]", "band_rad_s = [0.5]", ("study.band_rad_s", "missing")),
        ("band_rad_s = [0.5, 8.0]", "band_rad_s = [nan, 8.0]", ("study.band_rad_s", "finite")),
        ('target = "b"', 'target = "c"', ("study.target", "there are a, b")),
    ],
)
def test_a_typo_is_named_with_file_field_and_expectation(
    tmp_path: Path, right: str, wrong: str, named: tuple[str, ...]
) -> None:
    assert right in GOOD
    said = complaint(tmp_path, GOOD.replace(right, wrong))
    for part in named:
        assert part in said


def test_broken_toml_is_named_with_its_line(tmp_path: Path) -> None:
    assert "line 3" in complaint(tmp_path, 'schema = 1\nname = "lab"\nrobots = {\n')
    assert "not valid TOML" in complaint(tmp_path, b"\xff\xfe\x00")
    assert "robots" in complaint(tmp_path, 'schema = 1\nname = "lab"\nrobots = {}\n')
    assert "robots" in complaint(tmp_path, 'schema = 1\nname = "lab"\n')


def test_a_file_that_cannot_be_read_says_why(tmp_path: Path) -> None:
    with pytest.raises(FleetFileError, match=r"absent\.toml: cannot be read: No such file"):
        read_fleet_file(tmp_path / "absent.toml")
    with pytest.raises(FleetFileError, match="cannot be read: Is a directory"):
        read_fleet_file(tmp_path)


toml_scalars = (
    st.integers(-(2**63), 2**63 - 1)
    | st.booleans()
    | st.text(st.characters(codec="ascii", categories=["L", "N"]), max_size=8)
)


@settings(max_examples=60, deadline=None)
@given(document=st.dictionaries(st.sampled_from(["schema", "name", "robots", "x"]), toml_scalars))
def test_no_document_raises_anything_but_a_fleet_file_error(
    tmp_path_factory: pytest.TempPathFactory, document: dict[str, object]
) -> None:
    text = "\n".join(f"{key} = {json.dumps(value)}" for key, value in document.items())
    complaint(tmp_path_factory.mktemp("fleet"), text)


class Motor(Strict):
    gain: Positive
    gears: tuple[int, ...] = ()


def test_settings_are_checked_against_their_drivers_model(tmp_path: Path) -> None:
    path = tmp_path / "fleet.toml"
    motor = validated_settings(Motor, path, "arm-2", {"gain": 1.5, "gears": [1, 2]})
    assert motor == Motor(gain=1.5, gears=(1, 2))
    for wrong, named in (
        ({"gian": 1.5}, "gian"),
        ({"gain": -1.0}, "greater than 0"),
        ({"gain": float("nan")}, "gain"),
        ({"gain": "1.5"}, "valid number"),
        ({"gain": 1.5, "gears": [1.5]}, r"gears\.0"),
    ):
        with pytest.raises(FleetFileError, match=named) as raised:
            validated_settings(Motor, path, "arm-2", wrong)
        assert str(raised.value).startswith(f"{path}: robots.arm-2.settings: ")


def test_a_fleet_is_found_by_path_or_by_the_name_it_is_installed_under(tmp_path: Path) -> None:
    path = written(tmp_path, GOOD)
    assert find_fleet_file(str(path)) == path
    assert read_fleet_file(find_fleet_file("paper_linear")).name == "paper-linear"
    with pytest.raises(FleetFileError, match=r"no such fleet file; known by name: .*paper_linear"):
        find_fleet_file("paper_liner")
    with pytest.raises(FleetFileError, match="cannot be read: File name too long"):
        find_fleet_file("f" * 300)


def test_a_folder_that_has_the_name_of_an_installed_fleet_does_not_hide_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "weak_source").mkdir()
    monkeypatch.chdir(tmp_path)
    assert read_fleet_file(find_fleet_file("weak_source")).name == "weak-source"


def test_no_robot_flies_unguarded_unless_its_fleet_file_says_so(tmp_path: Path) -> None:
    path = tmp_path / "lab.toml"
    path.write_text(
        'schema = 1\nname = "lab"\n'
        '[robots.a]\ndriver = "d"\n'
        '[robots.b]\ndriver = "d"\nallow_unguarded = true\n'
    )
    robots = read_fleet_file(path).robots
    assert [robots[name].allow_unguarded for name in ("a", "b")] == [False, True]


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("192.168.1.10:7447", "neither an IP address nor a host name; `port` holds the port"),
        ("base:7447", "neither an IP address nor a host name; `port` holds the port"),
        ("192.168.1", "192.168.1 is neither an IP address nor a host name"),
        ("192.168.1.300", "192.168.1.300 is neither an IP address nor a host name"),
        ("base..example", "is no host name: there is nothing between two of its dots"),
        ("tcp/base", "pattern"),
        ("", "pattern"),
    ],
)
def test_an_address_that_no_router_can_have_is_named(
    address: str, words: str, tmp_path: Path
) -> None:
    for field in (f'addresses = ["{address}"]', f'addresses = ["base"]\nlisten = "{address}"'):
        assert words in complaint(tmp_path, f"{GOOD}[router]\n{field}\n")


@pytest.mark.parametrize(
    "address", ["192.168.1.10", "::1", "fe80::1", "base", "base-2.example.org"]
)
def test_an_address_without_a_port_is_taken(address: str, tmp_path: Path) -> None:
    router = read_fleet_file(
        written(tmp_path, f'{GOOD}[router]\naddresses = ["{address}"]\n')
    ).router
    assert router is not None
    assert router.addresses == (address,)
