"""Whether pages are compared with what is printed: a drift is found, and only a drift."""

from __future__ import annotations

from pathlib import Path

import pytest
from page_blocks import Block, blocks, difference

PRINTED = """
starting a router
│ source-2 │ 0.0212 │ 94.3 % │
│ source-4 │ 0.3883 │ -32.1 % │
wrote runs/20260102-lab-demo in 12 s
"""


@pytest.mark.parametrize(
    "shown",
    [
        PRINTED,
        "source-4 0.3883 -32.1 %",
        "┃ source-2 ┃\n┃ 0.0213 ┃ 92 % ┃",
        "starting a router\n…\nwrote …-lab-demo in … s",
        "source-2\n…\nsource-4",
    ],
)
def test_frames_lines_small_differences_and_ellipses_do_not_count(shown: str) -> None:
    assert difference(shown, PRINTED) is None


@pytest.mark.parametrize(
    ("shown", "words"),
    [
        ("source-2 0.0212 85.0 %", "85.0"),
        ("source-2 0.0212 94.3 mm", "mm"),
        ("source-3 0.0212", "source-3"),
        ("source-4\n…\nsource-2", "source-2"),
        ("source-4 0.3883 32.1 %", "32.1"),
        ("in … s to go", "to"),
    ],
)
def test_another_number_word_or_order_is_a_difference_that_is_named(shown: str, words: str) -> None:
    found = difference(shown, PRINTED)
    assert found is not None
    assert words in found


def test_a_block_says_by_the_comment_before_it_what_it_is(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "```\nnufleet rank --seed 3  # quick\nψ = 3\n```\n"
        "<!-- not run: it needs a drone -->\n```\nnufleet \\\n  track\n```\n"
        "<!-- run by tests/test_prose.py -->\n```\nhall$ nufleet view\n```\n"
        "<!-- printed -->\n```\nnufleet says so\n```\n```python\n1 + 1\n```\n"
    )
    first, second, third, fourth, fifth = blocks(page)
    assert first == Block("page.md", "", "", "nufleet rank --seed 3  # quick\nψ = 3\n")
    assert first.commands == ["nufleet rank --seed 3"]
    assert (second.commands, second.reason) == (["nufleet track"], "it needs a drone")
    assert (third.commands, third.tests[0].name) == (["hall$ nufleet view"], "test_prose.py")
    assert fourth.commands == fifth.commands == []
    assert [block.is_run for block in blocks(page)] == [True, False, False, True, True]
