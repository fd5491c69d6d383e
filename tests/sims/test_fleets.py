"""The fleets that come with nufleet are what their files say of them."""

from __future__ import annotations

import numpy as np
import pytest

from nufleet.shared.models.linear_model import LinearModel
from nufleet.shared.robots.fleet_file import FleetFile, find_fleet_file, read_fleet_file
from nufleet.sims.double_integrator import DoubleIntegratorSettings, closed_loop

OMEGA_RAD_S = np.geomspace(0.05, 10.0, 200)


def fleet(name: str) -> FleetFile:
    return read_fleet_file(find_fleet_file(name))


def loop(robot: str) -> LinearModel:
    settings = fleet("weak_source").robots[robot].settings
    return closed_loop(DoubleIntegratorSettings.model_validate(settings))


def test_the_demos_fleet_is_the_papers_with_one_more_source() -> None:
    paper, demo = fleet("paper_linear"), fleet("weak_source")
    assert demo.study == paper.study
    assert set(demo.robots) - set(paper.robots) == {"source-4"}
    for robot, entry in paper.robots.items():
        same = {name: demo.robots[robot].settings[name] for name in ("alpha", "beta")}
        assert same == entry.settings


@pytest.mark.parametrize(
    ("source", "harms"),
    [("source-1", False), ("source-2", False), ("source-3", False), ("source-4", True)],
)
def test_of_its_sources_the_weak_one_alone_makes_the_target_worse_at_every_frequency(
    source: str, harms: bool
) -> None:
    z_t = loop("target").frequency_response(OMEGA_RAD_S)
    z_s = loop(source).frequency_response(OMEGA_RAD_S)
    ratio = np.abs(1 - z_t / z_s) / np.abs(1 - z_t)
    assert ((ratio > 1) == harms).all()
    if harms:
        np.testing.assert_allclose(ratio, 0.85 / 0.33 - 1, rtol=1e-9)
