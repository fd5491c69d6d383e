"""A copy of a simulated robot answers as settings of its fleet file say, or other ones."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from puppet_robot import PuppetRobot, puppet_spec

from nufleet.orchestrator.conduct import simulator_copy
from nufleet.orchestrator.conduct.simulator_copy import SimulatorCopy
from nufleet.orchestrator.study.settings_fit import fit_settings
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.robots.drivers import SeparateRobots
from nufleet.shared.robots.fleet_file import FleetFile, read_fleet_file
from nufleet.sims.double_integrator import DoubleIntegratorSettings
from nufleet.sims.drivers import DOUBLE_INTEGRATOR

FLEET = """
schema = 1
name = "lab"
[robots.sim]
driver = "double_integrator"
settings = { alpha = 1.0, beta = 0.003, noise_std_m = 0.001 }
[robots.other]
driver = "double_integrator"
settings = { alpha = 0.85, beta = 0.003, k_d = 4.0, noise_std_m = 0.001 }
[robots.coupled]
driver = "coupled_loops"
settings = { natural_frequency_rad_s = [2.0, 3.0], damping_ratio = [0.6, 0.7], coupling = [0.0] }
[robots.sheltered]
driver = "faulty"
settings = { driver = "double_integrator", settings = { alpha = 1.0, beta = 0.003 } }
[robots.linked]
driver = "faulty"
settings.driver = "double_integrator"
settings.settings = { alpha = 1.0, beta = 0.003 }
settings.field = { delay_s = 0.02, jitter_s = 0.008 }
"""


@pytest.fixture
def path(tmp_path: Path) -> Path:
    (tmp_path / "lab.toml").write_text(FLEET)
    return tmp_path / "lab.toml"


@pytest.fixture
def plan() -> ExcitationPlan:
    built = DOUBLE_INTEGRATOR.build(
        {"sim": DoubleIntegratorSettings(alpha=1.0, beta=0.003)}, np.random.default_rng(0)
    )
    tones = tuple(Tone(omega_rad_s=w) for w in (1.0, 2.0, 3.0, 4.0, 6.0))
    return plan_excitation(Excitation(axis="x", tones=tones), built["sim"].spec, "sim")


@pytest.fixture
def fleet(path: Path) -> FleetFile:
    return read_fleet_file(path)


def test_the_settings_of_another_robot_are_recovered(
    fleet: FleetFile, path: Path, plan: ExcitationPlan
) -> None:
    simulator = SimulatorCopy(fleet, path, "sim", ["alpha", "k_d"])
    simulator.check()
    tests = [(plan, reference_of(plan))]
    own = SimulatorCopy(fleet, path, "other", []).responses({}, tests)
    found = fit_settings(
        own,
        lambda values: simulator.responses(values, tests),
        simulator.settings(),
        lambda _k, _most: None,
    )
    assert abs(found.settings["alpha"].value / 0.85 - 1) < 0.05
    assert abs(found.settings["k_d"].value / 4.0 - 1) < 0.05
    assert found.psi_left < 0.1 * found.psi


def test_a_setting_is_found_by_the_end_of_its_path_and_written_as_in_the_file(
    fleet: FleetFile, path: Path
) -> None:
    sheltered = SimulatorCopy(fleet, path, "sheltered", ["alpha"])
    assert list(sheltered.settings()) == ["settings.alpha"]
    coupled = SimulatorCopy(fleet, path, "coupled", ["natural_frequency_rad_s.1"])
    assert coupled.lines({"natural_frequency_rad_s.1": 3.21}) == (
        "[robots.coupled.settings]\nnatural_frequency_rad_s = [2.0, 3.21]"
    )


def test_a_setting_may_be_negative_only_where_its_driver_takes_it(
    fleet: FleetFile, path: Path
) -> None:
    settings = SimulatorCopy(fleet, path, "sim", ["alpha", "noise_std_m"]).settings()
    assert not any(one.negative for one in settings.values())
    assert SimulatorCopy(fleet, path, "coupled", ["coupling.0"]).settings()["coupling.0"].negative


def test_a_real_robot_is_no_simulator(
    fleet: FleetFile, path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = SeparateRobots(
        DoubleIntegratorSettings, lambda _settings, _rng: PuppetRobot(puppet_spec(simulated=False))
    )
    monkeypatch.setattr(simulator_copy, "load_driver", lambda _name: real)
    with pytest.raises(InvalidInputError, match="and sim is real; name its simulator"):
        SimulatorCopy(fleet, path, "sim", ["alpha"]).check()


def test_a_robot_that_records_apart_is_not_simulated(
    fleet: FleetFile, path: Path, plan: ExcitationPlan
) -> None:
    linked = SimulatorCopy(fleet, path, "linked", ["delay_s"])
    with pytest.raises(InvalidInputError, match="over which linked records its outputs"):
        linked.responses({}, [(plan, reference_of(plan))])


@pytest.mark.parametrize(
    ("robot", "setting", "words"),
    [
        ("sim", "mass_kg", "sim has no setting mass_kg; its settings that are numbers: alpha"),
        ("coupled", "axes.0", 'setting axes.0 of coupled is "x", and only numbers'),
        ("coupled", "damping_ratio", "coupled has no setting damping_ratio"),
        ("sheltered", "noise_std_m", "sheltered has no setting noise_std_m"),
    ],
)
def test_what_cannot_be_varied_is_refused(
    fleet: FleetFile, path: Path, robot: str, setting: str, words: str
) -> None:
    with pytest.raises(InvalidInputError, match=words):
        SimulatorCopy(fleet, path, robot, [setting])


def test_the_sample_time_of_the_tests_cannot_be_varied(
    fleet: FleetFile, path: Path, plan: ExcitationPlan
) -> None:
    simulator = SimulatorCopy(fleet, path, "sim", ["sample_time_s"])
    with pytest.raises(InvalidInputError, match=r"samples of 0\.015 s, which --fit cannot vary"):
        simulator.responses({"sample_time_s": 0.0151}, [(plan, reference_of(plan))])
