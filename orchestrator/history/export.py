"""The responses that a run measured, as files that `nufleet gap` and other programs read."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import TYPE_CHECKING

from nufleet.orchestrator.gap.measured_response import combined
from nufleet.orchestrator.gap.model_files import write_response
from nufleet.orchestrator.repository.records import TrialStatus
from nufleet.orchestrator.runs.folder import RESULTS, read_record, study_id_of
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

if TYPE_CHECKING:
    from nufleet.orchestrator.repository.repository import Repository

Responses = Mapping[str, Sequence[FrequencyResponse]]


def run_responses(
    folder: Path, open_repository: Callable[[], AbstractContextManager[Repository]]
) -> Responses:
    """Return every usable response of a run, by robot.

    Those of a ranking that ended are in its folder; those of any other run in the repository.

    Raises:
        InvalidInputError: the run measured none.
        RepositoryError: the repository cannot be read.
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
                    f"{folder.name} holds no responses, and {repository.name} none of it either; "
                    "name its repository with --repository"
                )
    return found


def export_responses(responses: Responses, to: Path, suffix: str) -> dict[str, Path]:
    """Write what each robot's tests found together to a file of its own.

    Args:
        responses: by robot.
        to: the folder, which is made.
        suffix: `json` or `csv`.

    Raises:
        ModelFileError: a robot was tested at fewer than two frequencies.
        InvalidInputError: the files cannot be written.
    """
    written: dict[str, Path] = {}
    try:
        to.mkdir(parents=True, exist_ok=True)
        for robot, tests in responses.items():
            path = to / f"{robot}.{suffix}"
            write_response(path, combined(tests))
            written[robot] = path
    except OSError as error:
        raise InvalidInputError(f"{to} cannot be written: {error.strerror}") from error
    return written


def _stored(repository: Repository, run_id: str) -> dict[str, list[FrequencyResponse]]:
    """Return the responses of a run's study, or of all its studies where it made several."""
    found: dict[str, list[FrequencyResponse]] = {}
    for study in repository.studies.studies():
        if study.study_id == run_id or study.study_id.startswith(f"{run_id}."):
            for trial in repository.studies.trials(study.study_id):
                if trial.status is TrialStatus.MEASURED and trial.response is not None:
                    found.setdefault(trial.intent.robot, []).append(trial.response)
    return found
