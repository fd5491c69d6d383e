"""Robots from a fleet file: found by their drivers' names, each with a noise of its own."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from contextlib import ExitStack, nullcontext
from pathlib import Path
from threading import Event
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest
from click.testing import CliRunner
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.orchestrator.fleet import processes
from nufleet.robot_agent import serve as fleet_robots
from nufleet.robot_agent.command import agent
from nufleet.robot_agent.robot import Robot
from nufleet.robot_agent.serve import build_robots
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import FleetFileError
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file
from nufleet.shared.strict import Strict
from nufleet.shared.wire.keys import FleetKeys
from nufleet.sims.double_integrator import DoubleIntegrator

NOISY = "{ alpha = 0.85, beta = 0.003, noise_std_m = 0.01 }"


def fleet_of(tmp_path: Path, robots: Mapping[str, str], seed: int = 3) -> tuple[FleetFile, Path]:
    path = tmp_path / "fleet.toml"
    entries = "".join(f"[robots.{name}]\n{entry}\n" for name, entry in robots.items())
    path.write_text(f'schema = 1\nname = "lab"\nseed = {seed}\n{entries}')
    return read_fleet_file(path), path


def integrator(settings: str = NOISY) -> str:
    return f'driver = "double_integrator"\nsettings = {settings}'


def flown(robot: Robot) -> FloatArray:
    robot.connect()
    return robot.run(np.zeros((50, 1)))


def test_robots_come_in_the_order_asked_for_with_their_own_settings(tmp_path: Path) -> None:
    fleet, path = fleet_of(
        tmp_path,
        {
            "a": integrator("{ alpha = 0.85, beta = 0.003 }"),
            "b": integrator("{ alpha = 1.0, beta = 0.004 }"),
        },
    )
    robots = build_robots(fleet, path, ("b", "a"))
    assert list(robots) == ["b", "a"]
    assert all(isinstance(robot, DoubleIntegrator) for robot in robots.values())
    models = [robot.spec.axes[0].model for robot in robots.values()]
    assert models[0] != models[1]


def test_a_robots_noise_is_its_own_and_depends_on_seed_and_place_alone(tmp_path: Path) -> None:
    names = ("a", "b", "c")
    fleet, path = fleet_of(tmp_path, dict.fromkeys(names, integrator()))
    together = {name: flown(robot) for name, robot in build_robots(fleet, path, names).items()}
    for name in names:
        alone = flown(build_robots(fleet, path, (name,))[name])
        np.testing.assert_array_equal(alone, together[name])
    for one, other in (("a", "b"), ("b", "c"), ("a", "c")):
        assert not np.array_equal(together[one], together[other])
    other_seed, path = fleet_of(tmp_path, dict.fromkeys(names, integrator()), seed=4)
    assert not np.array_equal(flown(build_robots(other_seed, path, ("a",))["a"]), together["a"])


def test_a_robot_that_is_not_in_the_file_is_named(tmp_path: Path) -> None:
    fleet, path = fleet_of(tmp_path, {"a": integrator(), "b": integrator()})
    with pytest.raises(FleetFileError, match=rf"{path}: no robot 'c'; there are a, b"):
        build_robots(fleet, path, ("a", "c"))


def test_a_driver_that_is_not_installed_is_named_with_those_that_are(tmp_path: Path) -> None:
    fleet, path = fleet_of(tmp_path, {"a": 'driver = "double_intergrator"'})
    with pytest.raises(
        FleetFileError,
        match=r"unknown driver 'double_intergrator'; installed drivers: .*double_integrator",
    ):
        build_robots(fleet, path, ("a",))


def test_a_setting_that_is_not_right_is_named_with_its_robot(tmp_path: Path) -> None:
    for settings, named in (
        ("{ alpha = -1.0, beta = 0.0 }", "alpha: must be greater than 0"),
        ("{ beta = 0.0 }", "alpha: missing"),
        ("{ alpha = 1.0, beta = 0.0, gamma = 1.0 }", "gamma: unknown"),
        ("{ alpha = 1.0, beta = 0.0, k_p = 1e9 }", "not stable"),
    ):
        fleet, path = fleet_of(tmp_path, {"a": integrator(), "b": integrator(settings)})
        with pytest.raises(FleetFileError) as raised:
            build_robots(fleet, path, ("a", "b"))
        assert str(raised.value).startswith(f"{path}: robots.b.settings: ")
        assert named in str(raised.value)


class Nothing(Strict):
    """No settings."""


class OnRadio(Strict):
    """A robot on a radio, or on a cable of its own."""

    radio: str | None = None


class SharedSimulator:
    """A driver whose robots live in one simulator; notes what it is asked to build."""

    settings = Nothing
    shares_process = True
    environment: Mapping[str, str] = {}

    def __init__(self) -> None:
        self.built: list[tuple[str, ...]] = []

    def build(self, settings: Mapping[str, Any], rng: np.random.Generator) -> Mapping[str, Any]:
        self.built.append(tuple(settings))
        return {name: PuppetRobot() for name in settings}


def test_robots_that_share_a_simulator_are_built_together_in_the_files_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = SharedSimulator()
    monkeypatch.setattr(fleet_robots, "load_driver", lambda name: driver)
    fleet, path = fleet_of(tmp_path, dict.fromkeys(("a", "b", "c"), 'driver = "shared"'))
    robots = build_robots(fleet, path, ("c", "a", "c"))
    assert driver.built == [("a", "c")]
    assert set(robots) == {"a", "c"}


class Radios(SharedSimulator):
    """A driver whose robots share what their settings name."""

    settings = OnRadio
    shares_process = False

    def shares(self, settings: OnRadio) -> str | None:
        return settings.radio


def test_robots_that_share_a_radio_are_built_together_and_the_others_apart(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver = Radios()
    monkeypatch.setattr(fleet_robots, "load_driver", lambda name: driver)
    monkeypatch.setattr(processes, "load_driver", lambda name: driver)

    def on(radio: str) -> str:
        return f'driver = "radios"\nsettings = {{ radio = "{radio}" }}'

    robots = {"a": on("0"), "b": on("1"), "c": on("0"), "d": 'driver = "radios"'}
    fleet, path = fleet_of(tmp_path, robots)
    build_robots(fleet, path, ("a", "b", "c", "d"))
    assert driver.built == [("a", "c"), ("b",), ("d",)]
    assert processes.grouped(fleet, processes=4) == [("a", "c"), ("b",), ("d",)]


class OpenSession:
    """A session that is always admitted."""

    def __init__(self, identity: object) -> None:
        self.identity = identity

    def check_admitted(self) -> None:
        """Agree."""


class SilentSquad:
    """A squad that hears and sends nothing."""

    def __init__(self, session: object, keys: FleetKeys) -> None:
        self.session = session

    def __enter__(self) -> SilentSquad:
        return self

    def __exit__(self, *_: object) -> None:
        """End nothing."""


@pytest.mark.parametrize("identity", [None, "that of a robot"])
def test_simulated_robots_share_a_session_and_every_real_one_has_its_own(
    monkeypatch: pytest.MonkeyPatch, identity: object
) -> None:
    monkeypatch.setattr(fleet_robots, "Squad", SilentSquad)
    monkeypatch.setattr(
        fleet_robots, "open_client", lambda address, **_: nullcontext(OpenSession(identity))
    )
    with ExitStack() as opened:
        sessions = fleet_robots.Sessions(opened, Event(), FleetKeys("lab"))
        simulated = [sessions.session("tcp/there:1", shared=True) for _ in range(3)]
        elsewhere = sessions.session("tcp/elsewhere:1", shared=True)
        real = [sessions.session("tcp/there:1", shared=False) for _ in range(2)]
    assert len(set(simulated)) == 1
    assert len({simulated[0], elsewhere, *real}) == 4
    assert None not in {one for _, one in (*simulated, elsewhere)}
    # The agent of a robot with a session of its own opens its squad.
    assert [one for _, one in real] == [None, None]


@pytest.mark.parametrize(
    ("simulated", "real", "asked_s"), [(500, 0, 0.1), (1, 0, None), (499, 1, None)]
)
def test_many_robots_take_the_interpreter_and_the_processor_seldom_unless_one_of_them_is_real(
    simulated: int, real: int, asked_s: float | None, monkeypatch: pytest.MonkeyPatch
) -> None:
    python_s, niced = sys.getswitchinterval(), Mock()
    monkeypatch.setattr(fleet_robots.os, "nice", niced)
    kinds = (*[True] * simulated, *[False] * real)
    specs = [puppet_spec().model_copy(update={"simulated": kind}) for kind in kinds]
    with fleet_robots.considerate([PuppetRobot(spec) for spec in specs]):
        assert sys.getswitchinterval() == pytest.approx(asked_s or python_s)
    assert sys.getswitchinterval() == python_s
    assert niced.called == (asked_s is not None)


def test_an_agent_serves_the_fleet_file_as_it_was_when_it_was_read_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _, path = fleet_of(tmp_path, {"a": integrator()})
    read: list[FleetFile] = []
    built: list[FleetFile] = []
    validate = FleetFile.model_validate_json

    def validated(text: str) -> FleetFile:
        read.append(validate(text))
        return read[-1]

    def refused(fleet: FleetFile, *_: object) -> Mapping[str, Robot]:
        built.append(fleet)
        raise FleetFileError("no robot can be built")

    monkeypatch.setattr(FleetFile, "model_validate_json", validated)
    monkeypatch.setattr(fleet_robots, "build_robots", refused)
    arguments = (str(path), "--connect", "tcp/127.0.0.1:7447", "--state", str(tmp_path))
    error = CliRunner().invoke(agent, arguments).exception
    assert isinstance(error, FleetFileError)
    assert len(read) == 1
    assert built[0] is read[0]
