"""Five drawings by hand, x and y in m, by name; closed and open, within ±1.35 m."""

from __future__ import annotations

from pathlib import Path

CLOVER = Path(__file__).with_name("clover.csv")
PEAR = Path(__file__).with_name("pear.csv")
RIBBON = Path(__file__).with_name("ribbon.csv")
SCRAWL = Path(__file__).with_name("scrawl.csv")
SHELL = Path(__file__).with_name("shell.csv")

ALL = (CLOVER, PEAR, RIBBON, SCRAWL, SHELL)
