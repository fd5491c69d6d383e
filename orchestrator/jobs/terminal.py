"""The terminal on which commands show progress and tables."""

from __future__ import annotations

from rich.console import Console


def stderr_console() -> Console:
    """Return the console for progress and tables, which leaves stdout to documents."""
    return Console(stderr=True, highlight=False, soft_wrap=True)
