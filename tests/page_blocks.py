"""The fenced blocks of a page: what a reader types, and what the page says is printed.

A comment in the page's source, on the line before a block, says what the block is:

    <!-- file: lab.toml -->          a file of this name in the reader's folder
    <!-- printed -->                 what the block before it prints
    <!-- printed by nufleet demo --> what this command prints
    <!-- run by FILE [FILE ...] -->  run by these tests, which hold its commands word for word
    <!-- not run: REASON -->         not run by any test

Every other block of commands or of Python is run, in the order of the page.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from fnmatch import fnmatchcase
from itertools import pairwise
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGES = (
    *(ROOT / page for page in ("README.md", "CONTRIBUTING.md", "deploy/README.md")),
    *sorted((ROOT / "docs").glob("*.md")),
)
WITHIN = 0.05
"""Largest relative difference of two numbers that agree, besides one unit of a last decimal."""

_BLOCK = re.compile(r"^(?:<!-- ([^\n]*?) -->\n)?```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)
_COMMAND = re.compile(r"\s*(nufleet|pip|cp|python|make|sudo|docker|\S+\$ +nufleet) ")
_FRAME = re.compile("[\u2500-\u257f]")
_NUMBER = re.compile(r"(?<![\w.-])[+-]?\d+(?:\.\d+)?(?:e[+-]?\d+)?")  # not the one of source-2


@dataclass(frozen=True)
class Block:
    """A fenced block of a page, with the comment before it."""

    page: str
    note: str
    language: str
    code: str

    @property
    def commands(self) -> list[str]:
        """The commands of a block, without their comments; none of a block of another language."""
        if self.language not in ("", "bash", "sh") or self.note.startswith("printed"):
            return []
        lines = self.code.replace("\\\n", " ").splitlines()
        return [without_comment(line) for line in lines if _COMMAND.match(line)]

    @property
    def reason(self) -> str | None:
        """Why the block is not run; None if it is."""
        return self.note.removeprefix("not run: ") if self.note.startswith("not run:") else None

    @property
    def tests(self) -> list[Path]:
        """The tests that run its commands in place of the page's story."""
        names = self.note.removeprefix("run by ").split() if self.note.startswith("run by ") else []
        return [ROOT / name for name in names]

    @property
    def is_run(self) -> bool:
        """Whether the page's story runs it."""
        runs = bool(self.commands) or self.language == "python" or self.note.startswith("printed")
        return runs and self.reason is None and not self.tests


def blocks(page: Path) -> list[Block]:
    """Return all blocks of a page, in its order."""
    found = _BLOCK.findall(page.read_text(encoding="utf-8"))
    return [Block(page.name, *parts) for parts in found]


def without_comment(line: str) -> str:
    """Return a command as it is typed."""
    return " ".join(re.sub(r"\s#\s.*", "", line).split())


def difference(shown: str, printed: str) -> str | None:
    """Return in which words a page differs from what was printed; None if it does not.

    Words have to follow one another as on the page, somewhere in what was printed. How lines are
    wrapped and framed does not count. A number may differ by `WITHIN`, or by one unit of its last
    decimal. An ellipsis stands for any words, and inside a word for any characters.
    """
    wanted, found = _words(shown), _words(printed)
    gaps = [-1, *(k for k, word in enumerate(wanted) if word == "…"), len(wanted)]
    start = 0
    for before, after in pairwise(gaps):
        part = wanted[before + 1 : after]
        places = range(start, len(found) - len(part) + 1)
        fits = [_agreeing(part, found[place:]) for place in places] or [0]
        if max(fits) < len(part):
            best = places[fits.index(max(fits))] if places else len(found)
            first = max(max(fits) - 3, 0)
            return (
                f"the page shows   … {' '.join(part[first : max(fits) + 5])} …\n"
                f"but printed was  … {' '.join(found[best + first : best + max(fits) + 5])} …"
            )
        start = places[fits.index(len(part))] + len(part) if part else start
    return None


def _words(text: str) -> list[str]:
    return _FRAME.sub(" ", text).split()


def _agreeing(wanted: list[str], found: list[str]) -> int:
    """Return how many words agree before the first that does not."""
    for count, (left, right) in enumerate(zip(wanted, found, strict=False)):
        if not _agree(left, right):
            return count
    return min(len(wanted), len(found))


def _agree(wanted: str, found: str) -> bool:
    if "…" in wanted:
        return fnmatchcase(found, wanted.replace("[", "[[]").replace("…", "*"))
    if _NUMBER.sub("#", wanted) != _NUMBER.sub("#", found):
        return False
    pairs = zip(_NUMBER.findall(wanted), _NUMBER.findall(found), strict=True)
    return all(_close(left, right) for left, right in pairs)


def _close(wanted: str, found: str) -> bool:
    decimals = len(wanted.partition("e")[0].partition(".")[2])
    allowed = max(WITHIN * abs(float(wanted)), 1.01 * 10.0**-decimals if decimals else 0.0)
    return abs(float(wanted) - float(found)) <= allowed
