"""The five drawings that come with the project can be flown at the paper's three speeds."""

from __future__ import annotations

import tomllib
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from nufleet.shared.paths.files import read_drawing
from nufleet.shared.paths.installed import ENTRY_POINT_GROUP
from nufleet.shared.paths.trajectories import check_trajectory, travel
from nufleet.shared.robots.spec import TrackingLimits
from nufleet.sims.drawings import ALL

ROOT = Path(__file__).parents[2]

LIMITS = TrackingLimits(
    position_max=1.5,
    speed_max=0.9,
    acceleration_max=1.6,
    correction_max=0.5,
    correction_speed_max=0.6,
)


@pytest.mark.parametrize("speed_m_s", [0.3, 0.6, 0.9])
@pytest.mark.parametrize("drawing", ALL, ids=lambda path: path.stem)
def test_a_drawing_reaches_its_speed_inside_the_workspace(drawing: Path, speed_m_s: float) -> None:
    path = travel(read_drawing(drawing), speed_m_s, LIMITS.acceleration_max, 0.02)
    check_trajectory(path, 0.02, LIMITS)
    speeds = np.linalg.norm(np.diff(path, axis=0), axis=1) / 0.02
    assert 0.95 * speed_m_s < speeds.max() <= 1.001 * speed_m_s


def test_there_are_five_different_drawings() -> None:
    lengths = {round(float(np.abs(np.diff(read_drawing(p), axis=0)).sum()), 3) for p in ALL}
    assert len(ALL) == len(lengths) == 5


def test_every_drawing_is_registered_under_its_own_name() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    registered = {
        name: EntryPoint(name, value, ENTRY_POINT_GROUP).load()
        for name, value in project["entry-points"][ENTRY_POINT_GROUP].items()
    }
    assert registered == {path.stem: path for path in ALL}
