"""A study that cannot continue leaves the reason in its run's folder, where lists find it."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn, cast
from unittest.mock import Mock

import pytest
from archived_studies import DESCRIPTIONS, PLAN, archive, begin
from rich.console import Console

from nufleet.orchestrator.conduct.archive import Archive
from nufleet.orchestrator.conduct.rank_run import ReadyStudy
from nufleet.orchestrator.conduct.replay import ResumeError
from nufleet.orchestrator.jobs import study as jobs
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.orchestrator.runs.headline import Headline, read_headline, write_headline
from nufleet.shared.errors import StudyError

__all__ = ["archive"]


@pytest.mark.parametrize(
    ("error", "left"),
    [
        (StudyError("the target is gone"), Headline(failure="the target is gone")),
        (ResumeError("not its trials"), Headline()),
        (KeyboardInterrupt(), Headline()),
    ],
    ids=lambda value: type(value).__name__,
)
def test_only_a_study_that_has_failed_for_good_is_listed_as_failed(
    archive: Archive,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    error: BaseException,
    left: Headline,
) -> None:
    study = begin(archive, "paper")

    def fail(*_: Any, **__: Any) -> NoReturn:
        with archive.conducting(study.study_id, lambda: None):
            raise error

    monkeypatch.setattr(jobs, "run_study", fail)
    monkeypatch.setattr(jobs, "LiveView", Mock())
    with RunFolder(tmp_path, "lab") as folder:
        write_headline(folder.path, Headline())
        opened = SimpleNamespace(
            connection=Mock(),
            clock=None,
            writer=Mock(),
            archive=archive,
            repository=archive.repository,
            folder=folder,
            draws=False,
            console=Console(quiet=True),
        )
        with pytest.raises(type(error)):
            jobs.follow_study(cast(Opening, opened), ReadyStudy(PLAN, DESCRIPTIONS, {}), study)
    assert read_headline(folder.path) == left
