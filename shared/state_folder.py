"""The default folder in which agents on this machine keep the data that must outlive them."""

from __future__ import annotations

import os
from pathlib import Path


def default_state_folder() -> Path:
    """Return nufleet's folder within the user's state folder (XDG Base Directory Specification)."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "nufleet"
