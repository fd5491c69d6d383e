"""Robots whose axes pull at each other answer with the Z(ω) that their model states."""

from __future__ import annotations

import json

import numpy as np
import pytest
from pydantic import ValidationError

from nufleet.shared.distance.chordal import worst_case_chordal_distance
from nufleet.shared.robots.fleet_file import find_fleet_file, read_fleet_file
from nufleet.sims.coupled_loops import CoupledLoops, CoupledLoopsSettings, closed_loops


def settings_with(**more: object) -> CoupledLoopsSettings:
    two = {"natural_frequency_rad_s": (4.0, 5.0), "damping_ratio": (0.7, 0.5), "coupling": (0.3,)}
    return CoupledLoopsSettings.model_validate({**two, **more})


def robot_with(**more: object) -> CoupledLoops:
    robot = CoupledLoops("robot", settings_with(**more), np.random.default_rng(0))
    robot.connect()
    return robot


def test_the_loops_obey_their_equation_of_motion() -> None:
    settings = settings_with()
    omega_rad_s = np.array([0.5, 2.0, 6.0])
    inertia, rates = settings.inertia, np.array(settings.natural_frequency_rad_s)
    damping = np.diag(2 * np.array(settings.damping_ratio) * rates)
    step_s = settings.sample_time_s
    for omega, z in zip(omega_rad_s, closed_loops(settings).graph(omega_rad_s)[:, 2:], strict=True):
        force = -(omega**2) * inertia + 1j * omega * damping + np.diag(rates**2)
        # A reference that is held for a sample is smaller by a sinc and later by half a sample.
        held = np.sinc(omega * step_s / 2 / np.pi) * np.exp(-0.5j * omega * step_s)
        np.testing.assert_allclose(z, held * np.linalg.solve(force, np.diag(rates**2)), atol=2e-4)


def test_a_reference_of_one_axis_moves_the_other_only_where_they_are_coupled() -> None:
    references = np.zeros((100, 2))
    references[10:, 0] = 0.1
    coupled, free = robot_with().run(references), robot_with(coupling=()).run(references)
    assert np.abs(coupled[:, 1]).max() > 0.005
    assert not free[:, 1].any()


def test_the_model_of_each_axis_is_its_own_entry() -> None:
    robot = robot_with()
    omega_rad_s = np.array([1.0, 3.0, 7.0])
    z = closed_loops(settings_with()).graph(omega_rad_s)[:, 2:]
    for place, axis in enumerate(robot.spec.axes):
        assert axis.model is not None
        np.testing.assert_allclose(axis.model.frequency_response(omega_rad_s), z[:, place, place])


def test_it_comes_to_rest_from_any_motion() -> None:
    robot = robot_with(noise_std_m=0.01)
    robot.run(np.full((50, 2), 0.2))
    robot.rest()
    assert np.abs(robot.observe()[:, 1]).max() < 1e-3
    robot.disconnect()


LIMITS = {"amplitude_max": 1.0, "velocity_max": 1.0, "acceleration_max": 1.0}


@pytest.mark.parametrize(
    ("wrong", "words"),
    [
        ({"coupling": (0.1, 0.1)}, "coupling needs 1 values"),
        ({"coupling": (1.0,)}, "couple the axes less"),
        ({"damping_ratio": (0.7,)}, "damping_ratio needs 2 values"),
        ({"limits": {"z": LIMITS}}, "limits of z, which are not among the axes"),
    ],
)
def test_settings_that_describe_no_robot_are_refused(wrong: dict[str, object], words: str) -> None:
    with pytest.raises(ValidationError, match=words):
        settings_with(**wrong)


def test_the_axes_of_the_fleet_off_centre_disagree_on_the_best_source() -> None:
    fleet = read_fleet_file(find_fleet_file("off_centre"))
    assert fleet.study is not None
    band = fleet.study.band_rad_s
    models = {
        name: [
            axis.model
            for axis in CoupledLoops(
                name,
                CoupledLoopsSettings.model_validate_json(json.dumps(entry.settings)),
                np.random.default_rng(0),
            ).spec.axes
        ]
        for name, entry in fleet.robots.items()
    }
    psi = {
        name: [
            worst_case_chordal_distance(at_target, model, band)[0]
            for at_target, model in zip(models["target"], own, strict=True)
            if at_target is not None and model is not None
        ]
        for name, own in models.items()
        if name != "target"
    }
    assert min(psi, key=lambda name: psi[name][0]) == "source-1"
    assert min(psi, key=lambda name: psi[name][1]) == "source-3"
    assert min(psi, key=lambda name: max(psi[name])) == "source-2"


def test_a_robot_with_height_and_heading_has_units_and_limits_of_its_own_and_takes_no_paths() -> (
    None
):
    fleet = read_fleet_file(find_fleet_file("hovering"))
    for name, entry in fleet.robots.items():
        own = CoupledLoopsSettings.model_validate_json(json.dumps(entry.settings))
        spec = CoupledLoops(name, own, np.random.default_rng(0)).spec
        assert {axis.name: (axis.unit, axis.amplitude_max) for axis in spec.axes} == {
            "x": ("m", 0.5),
            "y": ("m", 0.5),
            "z": ("m", 0.3),
            "yaw": ("rad", 0.8),
        }
        assert spec.tracking is None
