"""The work of commands, called from a script: typed results, and nothing fetched twice."""

from __future__ import annotations

import io
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from counted_fleet import Counted
from rich.console import Console

from nufleet.orchestrator.jobs import demo as demo_job
from nufleet.orchestrator.jobs import study as study_job
from nufleet.orchestrator.jobs.demo import DemoCommand, demo
from nufleet.orchestrator.jobs.rank import RankCommand, rank
from nufleet.orchestrator.jobs.resume import ResumeCommand, resume_run
from nufleet.orchestrator.jobs.storage import Storage
from nufleet.orchestrator.repository.records import StudyStatus
from nufleet.orchestrator.viewer.writer import RerunWriter
from nufleet.shared.errors import NufleetError
from nufleet.shared.robots.fleet_file import find_fleet_file

ROBOTS = ("target", "source-1", "source-2", "source-3")
ONCE = dict.fromkeys(ROBOTS, 1)
QUIET = Console(quiet=True)


def cut(*_: object, **__: object) -> Any:
    raise NufleetError("the cable was cut")


def test_a_ranking_whose_recording_cannot_be_opened_stores_no_study_and_promises_no_resumption(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    said = io.StringIO()
    monkeypatch.setattr(RerunWriter, "open", cut)
    command = RankCommand(runs_root=tmp_path, fleet_file=find_fleet_file("paper_linear"))
    with pytest.raises(NufleetError, match="cable"):
        rank(command, Console(file=said, soft_wrap=True))
    assert "it can be resumed" not in said.getvalue()
    with Storage(tmp_path).open() as repository:
        assert not repository.studies.studies(StudyStatus.OPEN)


def test_an_interrupted_ranking_goes_on_and_nothing_is_read_or_described_twice(
    counted: Counted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = find_fleet_file("paper_linear")
    command = RankCommand(runs_root=tmp_path, fleet_file=file, draws=False, rehearses=False)
    with monkeypatch.context() as patched:
        patched.setattr(study_job, "run_study", cut)
        with pytest.raises(NufleetError, match="cable"):
            rank(command, QUIET)
    counted.files = 0
    counted.descriptions.clear()
    record = resume_run(ResumeCommand(runs_root=tmp_path, draws=False, rehearses=False), QUIET)
    assert record.result.selected == "source-2"
    assert counted == Counted(1, Counter(ONCE))


def test_the_demo_reads_its_fleet_file_once_and_describes_each_robot_once_before_anything_moves(
    counted: Counted, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_job, "follow_study", cut)
    with pytest.raises(NufleetError, match="cable"):
        demo(DemoCommand(runs_root=tmp_path), QUIET)
    assert counted == Counted(1, Counter((*ROBOTS, "source-4")))
