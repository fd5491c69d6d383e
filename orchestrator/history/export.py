"""Exports the responses that a run measured as files for `nufleet gap` and other programs."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from nufleet.orchestrator.gap.measured_response import combined
from nufleet.orchestrator.gap.model_files import write_response
from nufleet.orchestrator.repository.records import TrialStatus
from nufleet.orchestrator.runs.folder import RESULTS, read_record, study_id_of
from nufleet.shared.errors import InvalidInputError, system_errors_as
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.repository import Repository

Responses = Mapping[str, Sequence[FrequencyResponse]]


def run_responses(
    folder: Path, open_repository: Callable[[], AbstractContextManager[Repository]]
) -> Responses:
    """Return all usable responses of a run, by robot.

    Responses of a completed ranking are in its folder; those of any other run are in the
    repository.

    Args:
        folder: Folder of the run.
        open_repository: Function that opens the repository, called only if it is needed.

    Raises:
        InvalidInputError: The run measured no usable response.
        RepositoryError: The repository cannot be read.
    """
    found: Responses = {}
    if (folder / RESULTS).exists():
        kept = read_record(folder).responses
        found = {robot: [one.response() for one in tests] for robot, tests in kept.items()}
    if not found:
        with open_repository() as repository:
            found = _stored(repository, study_id_of(folder))
            if not found:
                raise InvalidInputError(
                    f"{folder.name} holds no responses, and neither does {repository.name}; "
                    "name the repository of the run with --repository"
                )
    return found


def export_responses(responses: Responses, to: Path, suffix: str) -> dict[str, Path]:
    """Write the combined response of each robot to a file of its own, or of each tested axis.

    Args:
        responses: Usable responses, by robot.
        to: Folder for the files, created if it is missing.
        suffix: Format of the files, `json` or `csv`.

    Returns:
        The file of each robot, by robot; of robots tested on several axes, that of each axis, by
        robot and axis, such as `drone-1-x`.

    Raises:
        ModelFileError: A robot was tested at fewer than two frequencies.
        InvalidInputError: The files cannot be written.
    """
    written: dict[str, Path] = {}
    with system_errors_as(InvalidInputError, f"{to} cannot be written"):
        to.mkdir(parents=True, exist_ok=True)
        for robot, tests in responses.items():
            by_axis: dict[str, list[FrequencyResponse]] = {}
            for test in tests:
                for axis, own in (test.own_entries or {"": test}).items():
                    by_axis.setdefault(axis, []).append(own)
            for axis, own_tests in by_axis.items():
                name = robot if len(by_axis) == 1 else f"{robot}-{axis}"
                written[name] = to / f"{name}.{suffix}"
                write_response(written[name], combined(own_tests))
    return written


def _stored(repository: Repository, run_id: str) -> dict[str, list[FrequencyResponse]]:
    """Return the responses of all studies that a run conducted."""
    found: dict[str, list[FrequencyResponse]] = {}
    for study in repository.studies.studies():
        if study.study_id == run_id or study.study_id.startswith(f"{run_id}."):
            for trial in repository.studies.trials(study.study_id):
                if trial.status is TrialStatus.MEASURED and trial.response is not None:
                    found.setdefault(trial.intent.robot, []).append(trial.response)
    return found
