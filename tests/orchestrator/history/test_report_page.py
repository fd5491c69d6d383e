"""What a run leaves to be handed on: a page that needs nothing else, and a table of its ranking."""

from __future__ import annotations

import re
from html.parser import HTMLParser
from pathlib import Path

import pytest
from kept_runs import ENDED, leave
from run_records import a_record

from nufleet.orchestrator.history.catalogue import read_run
from nufleet.orchestrator.history.report_page import (
    PAGE,
    RANKING,
    leave_report,
    ranking_csv,
    report_page,
)
from nufleet.shared.text import printable

ONE_PIXEL = bytes.fromhex("89504e470d0a1a0a")


class Tags(HTMLParser):
    """Checks that elements are closed in the order in which they were opened."""

    def __init__(self) -> None:
        super().__init__()
        self.open: list[str] = []

    def handle_starttag(self, tag: str, attrs: object) -> None:
        if tag not in ("meta", "img"):
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.mark.parametrize("kind", ENDED)
def test_every_kind_of_run_leaves_one_page_with_its_answer_that_loads_nothing(
    tmp_path: Path, kind: str
) -> None:
    folder = leave(tmp_path, kind)
    (folder / "plots").mkdir()
    (folder / "plots" / "psi_over_frequency.png").write_bytes(ONE_PIXEL)
    page = leave_report(folder)
    assert page == folder / PAGE
    text = page.read_text(encoding="utf-8")
    tags = Tags()
    tags.feed(text)
    assert tags.open == []
    _, _, headline, shown = ENDED[kind]
    assert headline in text
    assert shown in text
    assert "data:image/png;base64,iVBORw0KGgo=" in text
    assert not re.search(r"(src|href)=.(?!data:)|@import|url\(", text)
    assert page.stat().st_mode & 0o077 == 0
    assert (folder / RANKING).exists() == (kind in ("rank", "demo"))


def test_a_run_that_did_not_end_leaves_no_page(tmp_path: Path) -> None:
    folder = leave(tmp_path, "rank", ended=False)
    assert leave_report(folder) is None
    assert not (folder / PAGE).exists()


def test_it_says_how_to_repeat_the_run_and_lets_no_name_act_as_markup(tmp_path: Path) -> None:
    run = read_run(leave(tmp_path, "rank"))
    command = ["rank", "--trajectory", "my <b>heart</b>.svg"]
    page = report_page(run, {"command": command, "versions": {"nufleet": "1.2.3"}, "seed": 3})
    assert "nufleet rank --trajectory &#x27;my &lt;b&gt;heart&lt;/b&gt;.svg&#x27;" in page
    assert "With nufleet 1.2.3." in page
    assert "&quot;seed&quot;: 3" in page
    assert printable(page.replace("\n", " ")) == page.replace("\n", " ")


def test_a_ranking_is_a_table_for_spreadsheets(tmp_path: Path) -> None:
    assert ranking_csv(a_record(tmp_path).result).splitlines() == [
        "source,psi,psi_low,psi_high,omega_rad_s,tests,verdict",
        "source-1,0.07,0.068,0.073,4.5,2,",
    ]
