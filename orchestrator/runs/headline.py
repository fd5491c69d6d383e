"""What a run came to in one line, kept beside its results so that a list need not read them.

The results are the truth, and a headline is what they said when it was written. One that does not
fit what lies in the folder is not believed.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import asdict, dataclass
from pathlib import Path

from nufleet.orchestrator.runs.folder import CONFIGURATION
from nufleet.shared.private_files import write_privately
from nufleet.shared.text import printable

HEADLINE = "headline.json"
_SCHEMA = 1


@dataclass(frozen=True)
class Headline:
    """What a run came to."""

    text: str = ""
    """Summary of the results in one line; empty without results."""
    results: str = ""
    """Name of the file with the results; empty if the run left none."""
    failure: str = ""
    """Reason why the run can never continue; empty if it ended well, runs, or was interrupted."""


def write_headline(folder: Path, headline: Headline) -> None:
    """Keep the headline of a run, in place of an earlier one.

    Args:
        folder: Folder of the run; its results are complete.
        headline: What the run came to.

    Raises:
        OSError: It cannot be written, or the results cannot be read.
    """
    kept = {
        "schema": _SCHEMA,
        **asdict(headline),
        "results_sha256": _digest(folder / headline.results) if headline.results else "",
    }
    write_privately(folder / HEADLINE, (json.dumps(kept, indent=2) + "\n").encode())


def read_headline(folder: Path) -> Headline | None:
    """Return the headline of a run; None if there is none that fits what lies in its folder.

    A run of an older version kept none; one that was killed between its results and its headline
    kept only that it had begun.

    Args:
        folder: Folder of the run.
    """
    try:
        kept = json.loads((folder / HEADLINE).read_bytes())
        match kept:
            case {
                "schema": 1,  # _SCHEMA; a name here would capture the number
                "text": str(text),
                "results": str(results),
                "failure": str(failure),
                "results_sha256": str(digest),
            } if _fits(folder, results, digest):
                return Headline(printable(text), results, printable(failure))
    except (OSError, ValueError, RecursionError):
        return None
    return None


def _fits(folder: Path, results: str, digest: str) -> bool:
    if not results:
        return {path.name for path in folder.glob("*.json")} <= {CONFIGURATION, HEADLINE}
    return results == Path(results).name and digest == _digest(folder / results)


def _digest(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()
