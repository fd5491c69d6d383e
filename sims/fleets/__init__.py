"""The fleet files that come with nufleet, by name (entry-point group `nufleet.fleets`)."""

from __future__ import annotations

from pathlib import Path

PAPER_LINEAR = Path(__file__).with_name("paper_linear.toml")
