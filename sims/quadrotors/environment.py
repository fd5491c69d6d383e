"""The environment that a process needs, from its very start, to host simulated quadrotors."""

from __future__ import annotations

import hashlib
import os
import platform
from pathlib import Path


def environment() -> dict[str, str]:
    """Return the variables to set before the process imports anything."""
    variables = {
        # crazyflow needs SciPy's array interface, which SciPy reads when it is first imported.
        "SCIPY_ARRAY_API": "1",
        "JAX_PLATFORMS": "cpu",  # one vehicle is far too small for an accelerator
        "TF_CPP_MIN_LOG_LEVEL": "3",  # otherwise kilobytes of messages about CPU features
    }
    cache = _user_cache()
    if cache is not None:
        variables["JAX_COMPILATION_CACHE_DIR"] = str(cache / "nufleet" / f"jax-{cpu_kind()}")
    return variables


def cpu_kind() -> str:
    """Return a short name of this kind of CPU.

    A program compiled for one kind of CPU may not run on another, so a home directory shared by
    several machines holds one cache for each kind.
    """
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    telling = sorted({line for line in lines if line.startswith(("model name", "flags", "Feat"))})
    description = "\n".join(telling) or f"{platform.machine()} {platform.processor()}"
    return hashlib.sha256(description.encode()).hexdigest()[:12]


def _user_cache() -> Path | None:
    """Return the user's own cache folder; None for a user without a home, such as a service."""
    configured = os.environ.get("XDG_CACHE_HOME")
    if configured:
        return Path(configured)
    try:
        return Path.home() / ".cache"
    except RuntimeError:
        return None
