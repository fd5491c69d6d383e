"""Ids by which robots know orchestrators and the people at a command line."""

from __future__ import annotations

import os
import re


def new_orchestrator_id() -> str:
    """Return a unique id that contains host and process, so that a person can find its owner."""
    host = re.sub("[^0-9a-z-]", "-", os.uname().nodename.lower())[:32]
    return f"orchestrator-{host}-{os.getpid()}-{os.urandom(4).hex()}"
