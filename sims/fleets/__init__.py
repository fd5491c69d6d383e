"""The fleet files that come with nufleet, by name (entry-point group `nufleet.fleets`)."""

from __future__ import annotations

from pathlib import Path

ARMS = Path(__file__).with_name("arms.toml")
CRAZYFLIES_4_AXES = Path(__file__).with_name("crazyflies_4_axes.toml")
HOVERING = Path(__file__).with_name("hovering.toml")
OFF_CENTRE = Path(__file__).with_name("off_centre.toml")
PAPER_LINEAR = Path(__file__).with_name("paper_linear.toml")
PAPER_QUADROTORS = Path(__file__).with_name("paper_quadrotors.toml")
PARCELS = Path(__file__).with_name("parcels.toml")
PITCH_ARMS = Path(__file__).with_name("pitch_arms.toml")
WEAK_SOURCE = Path(__file__).with_name("weak_source.toml")
WORN_ARMS = Path(__file__).with_name("worn_arms.toml")
