"""Ids by which robots know orchestrators and the people at a command line."""

from __future__ import annotations

import os
import re

from nufleet.shared.wire.keys import DEFAULT_PRINCIPAL


def new_orchestrator_id(principal: str = DEFAULT_PRINCIPAL) -> str:
    """Return a unique id that contains host and process, so that a person can find its owner.

    Args:
        principal: Name under which the fleet knows the sender; the id begins with it, so that
            robots can compare it with the name that the router has proven.
    """
    host = re.sub("[^0-9a-z-]", "-", os.uname().nodename.lower())[:32]
    return f"{principal}.{host}-{os.getpid()}-{os.urandom(4).hex()}"
