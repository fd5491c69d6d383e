"""Documentation, comments and messages are written in plain English.

Each habit below makes a native reader stop. A sentence that is right all the same is listed in
`RIGHT_AS_THEY_ARE`.
"""

from __future__ import annotations

import re
import tokenize
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FOLDERS = ("benchmarks", "orchestrator", "robot_agent", "shared", "sims")
PAGES = ("README.md", "CONTRIBUTING.md", "CHANGELOG.md", "deploy/README.md")


@dataclass(frozen=True)
class Habit:
    """A habit of writing, recognised in one line of prose."""

    pattern: re.Pattern[str]
    better: str
    """Advice to the writer of the line, with an example."""


def habit(pattern: str, better: str) -> Habit:
    return Habit(re.compile(pattern), better)


HABITS = (
    habit(
        r'^\s*("""|#|\w+:) ?Of (the|these|those|an?|several|all|what|each|one|that|it|course)\b'
        r"|^\s+\w+: of (the|its|one|all|different|an?|what)\b"
        r'|"""Of ',
        "begin with the thing itself: instead of 'Of the limit: what is left is for corrections' "
        "write 'Fraction of the limit; the rest is headroom for corrections'",
    ),
    habit(
        r"^\s+\w+: ((the|its|an?|that) )?\w+('s|s')\.$|[a-z]('s|s')\.\"\"\"",
        "give the genitive its noun: instead of 'spec: the target's.' write 'spec: Spec of the "
        "target.'",
    ),
    habit(
        r"\b[Ss]o (long|often|many|far|much|fast)\b",
        "say how much: instead of 'so long a lease outlives its owner' write 'how long a lease "
        "outlives its owner'; instead of 'so often', 'every N seconds'",
    ),
    habit(
        r"^\s+\w+: (where|who|flies|how|what|when|which|it|whether it)\b[a-z ]{0,14}\.$",
        "describe an argument by a noun phrase: instead of 'robot: who.' write 'robot: Name of the "
        "robot that flies.'",
    ),
    habit(
        r"\b([Ww]hoever|[Nn]obody|[Ww]hatever|[Ss]omebody|[Ww]herever)\b",
        "name the thing: instead of 'nobody is there' write 'no robot is there'; instead of "
        "'whoever asks', 'any sender'",
    ),
    habit(
        r"\b(see to|seen to|let go|lets? expect|anew|is that of|are those of|stands? beside"
        r"|shouted|the way back|made again|(go|goes|going|gone) on|tells? of)\b",
        "use the plain verb: 'inspect', 'release', 'again', 'equals', 'continues', 'reports'",
    ),
)

RIGHT_AS_THEY_ARE = (
    '" so far"',  # in a picture, behind an error: of a flight that has not ended
)

# From Python 3.12 on, an f-string is several tokens, and its words are tokens of a kind of its own.
TEXT = {tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING)}


def prose(path: Path) -> Iterator[tuple[int, str]]:
    """Yield the lines of a page, or of a module's strings and comments, with their numbers."""
    if path.suffix != ".py":
        yield from enumerate(path.read_text(encoding="utf-8").splitlines(), start=1)
        return
    with tokenize.open(path) as source:
        for token in tokenize.generate_tokens(source.readline):
            if token.type in TEXT:
                yield from enumerate(token.string.splitlines(), start=token.start[0])


def offences(line: str) -> list[str]:
    """Return the advice about a line of prose; empty if there is nothing to say."""
    for phrase in RIGHT_AS_THEY_ARE:
        line = line.replace(phrase, "")
    return [known.better for known in HABITS if known.pattern.search(line)]


FILES = [
    *(path for folder in FOLDERS for path in sorted((ROOT / folder).rglob("*.py"))),
    *sorted((ROOT / "docs").rglob("*.md")),
    *(ROOT / page for page in PAGES),
]


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_prose_is_plain(path: Path) -> None:
    found = [
        f"{path.relative_to(ROOT)}:{number}: {line.strip()}\n    {advice}"
        for number, line in prose(path)
        for advice in offences(line)
    ]
    assert not found, "\n".join(["reword:", *found])


@pytest.mark.parametrize(
    "line",
    [
        '    """Of these axes."""',
        "        spec: the target's.",
        "# So long a lease outlives its owner.",
        "        robot: who.",
        '"nobody is there"',
        "# begin anew",
        "# let it go on",
    ],
)
def test_a_habit_is_recognised(line: str) -> None:
    assert offences(line)


@pytest.mark.parametrize("phrase", RIGHT_AS_THEY_ARE)
def test_every_exception_is_still_needed(phrase: str) -> None:
    assert any(phrase in line for path in FILES for _, line in prose(path))
