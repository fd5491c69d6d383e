"""The location of Rerun's viewer program, and the environment that it runs in."""

from __future__ import annotations

import os
from importlib.util import find_spec
from pathlib import Path

from nufleet.shared.errors import NufleetError


def rerun_program() -> Path:
    """Return the path of the viewer's binary.

    The `rerun` command that pip installs is a wrapper that leaves the viewer running when the
    wrapper is ended.

    Raises:
        NufleetError: The viewer is not installed.
    """
    package = find_spec("rerun_cli")
    if package is None or package.origin is None:
        raise NufleetError("the Rerun viewer is missing; install the package rerun-sdk")
    folder = Path(package.origin).parent
    # On macOS it may be installed as an application.
    for name in ("rerun", "Rerun.app/Contents/MacOS/Rerun"):
        if (folder / name).exists():
            return folder / name
    raise NufleetError(f"the Rerun viewer is missing: it is not in {folder}")


def rerun_environment() -> dict[str, str]:
    """Return the environment variables with which Rerun sends no usage statistics.

    Statistics are on by default. Rerun has a command that turns them off for a user's whole
    account; `CI` turns them off for one process and leaves the account as it is.
    """
    environment = {k: v for k, v in os.environ.items() if k != "FORCE_RERUN_ANALYTICS"}
    return {**environment, "CI": "1"}
