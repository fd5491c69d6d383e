"""The settings of quadrotors refuse what cannot be flown, and the paper's fleet keeps its rules."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from pydantic import ValidationError

from nufleet.shared.robots.fleet_file import FleetFile
from nufleet.sims.quadrotors.settings import AttitudeVehicle, MellingerVehicle, QuadrotorSettings

BEBOP = {
    "controller": "offboard_pd",
    "mass_kg": 0.5,
    "attitude_stiffness_1_s2": 200.0,
    "attitude_damping_1_s": 45.0,
    "drag_1_s": 0.3,
    "link_delay_s": 0.06,
    "time_constant_s": 0.6,
    "damping_ratio": 1.0,
    "tilt_max_rad": 0.5,
}


@pytest.mark.parametrize("delay_s", [0.065, 0.32, 1.0, -0.01])
def test_a_link_delay_must_be_whole_control_periods_and_fit_the_link(delay_s: float) -> None:
    with pytest.raises(ValidationError, match="link_delay_s"):
        AttitudeVehicle.model_validate(BEBOP | {"link_delay_s": delay_s})


@pytest.mark.parametrize(("delay_s", "ticks"), [(0.0, 0), (0.07, 7), (0.29, 29), (0.31, 31)])
def test_a_link_delay_becomes_control_periods(delay_s: float, ticks: int) -> None:
    vehicle = AttitudeVehicle.model_validate(BEBOP | {"link_delay_s": delay_s})
    assert vehicle.link_ticks == ticks


@pytest.mark.parametrize(
    "vehicle",
    [
        BEBOP | {"mass_kg": 0.0},
        BEBOP | {"tilt_max_rad": 1.5},
        BEBOP | {"airframe": "cf2x_L250"},
        {"controller": "mellinger", "mass_kg": 0.03, "dynamics": "so_rpy", "airframe": "x500"},
        {"controller": "mine", "mass_kg": 0.03},
    ],
)
def test_a_vehicle_that_is_not_one_is_refused(vehicle: dict[str, object]) -> None:
    with pytest.raises(ValidationError):
        QuadrotorSettings.model_validate({"vehicle": vehicle})


def test_the_papers_fleet_has_its_masses_band_and_sources(
    fleet_file: Callable[[str], FleetFile], paper_settings: dict[str, QuadrotorSettings]
) -> None:
    study = fleet_file("paper_quadrotors").study
    assert study is not None
    assert (study.target, study.band_rad_s) == ("target", (0.1, 5.4))
    assert list(paper_settings) == ["target", *(f"source-{n}" for n in range(1, 6))]
    masses_kg = {name: entry.vehicle.mass_kg for name, entry in paper_settings.items()}
    assert (masses_kg["target"], masses_kg["source-1"]) == (0.036, 0.031)
    for settings in paper_settings.values():
        assert (settings.omega_min_rad_s, settings.omega_max_rad_s) == (0.1, 5.4)


def test_the_crazyflies_differ_in_mass_or_fidelity_only(
    paper_settings: dict[str, QuadrotorSettings],
) -> None:
    target = paper_settings["target"]
    assert isinstance(target.vehicle, MellingerVehicle)
    lighter = target.vehicle.model_copy(update={"mass_kg": 0.031})
    coarser = target.vehicle.model_copy(update={"dynamics": "so_rpy"})
    assert paper_settings["source-1"] == target.model_copy(update={"vehicle": lighter})
    assert paper_settings["source-2"] == target.model_copy(update={"vehicle": coarser})


def margins(vehicle: AttitudeVehicle, time_constant_s: float) -> tuple[float, float]:
    """Return the gain margin [dB] and the phase margin [deg] of the loop cut at the command."""
    omega = np.linspace(0.5, 30.0, 200_000)
    s = 1j * omega
    stiffness, damping = vehicle.attitude_stiffness_1_s2, vehicle.attitude_damping_1_s
    loop = (
        (2 * vehicle.damping_ratio * s / time_constant_s + time_constant_s**-2)
        / (s * (s + vehicle.drag_1_s))
        * stiffness
        / (s**2 + damping * s + stiffness)
        * np.exp(-s * (vehicle.link_delay_s + 0.005))  # half a control period of holding
    )
    gain, phase = np.abs(loop), np.unwrap(np.angle(loop))
    crossover = int(np.flatnonzero((gain[:-1] >= 1) & (gain[1:] < 1))[-1])
    turned = int(np.flatnonzero(phase < -math.pi)[0])
    return -20 * math.log10(gain[turned]), 180 + math.degrees(phase[crossover])


@pytest.mark.parametrize("name", ["source-3", "source-5"])
def test_the_ground_controllers_are_as_fast_as_6_db_and_30_degrees_allow(
    name: str, paper_settings: dict[str, QuadrotorSettings]
) -> None:
    vehicle = paper_settings[name].vehicle
    assert isinstance(vehicle, AttitudeVehicle)
    assert vehicle.damping_ratio == 1.0
    kept = [
        gain_db >= 6 and phase_deg >= 30
        for gain_db, phase_deg in (
            margins(vehicle, vehicle.time_constant_s),
            margins(vehicle, vehicle.time_constant_s - 0.1),
        )
    ]
    assert kept == [True, False]


def test_the_simulated_ar_drone_flies_with_the_ar_drones_controller(
    paper_settings: dict[str, QuadrotorSettings],
) -> None:
    real, simulated = paper_settings["source-3"].vehicle, paper_settings["source-4"].vehicle
    assert isinstance(real, AttitudeVehicle)
    assert isinstance(simulated, AttitudeVehicle)
    for field in ("time_constant_s", "damping_ratio", "tilt_max_rad"):
        assert getattr(real, field) == getattr(simulated, field)
