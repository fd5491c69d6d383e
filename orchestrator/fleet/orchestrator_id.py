"""The ids under which orchestrators, and people at a command line, are known to robots."""

from __future__ import annotations

import os
import re


def new_orchestrator_id() -> str:
    """Return an id that no other orchestrator has: with host and process, to find it by."""
    host = re.sub("[^0-9a-z-]", "-", os.uname().nodename.lower())[:32]
    return f"orchestrator-{host}-{os.getpid()}-{os.urandom(4).hex()}"
