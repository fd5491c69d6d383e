"""Where agents on this machine keep what has to survive them, unless they are told."""

from __future__ import annotations

import os
from pathlib import Path


def default_state_folder() -> Path:
    """Return the folder for a user's state (XDG Base Directory Specification), ours in it."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "nufleet"
