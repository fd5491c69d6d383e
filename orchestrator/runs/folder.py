"""The folder of a run: configuration, results, samples, recording, plots and report.

Only its user may read it.
"""

from __future__ import annotations

import fcntl
import json
import os
import platform
import re
import shutil
import sys
import tempfile
from collections.abc import Mapping
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from nufleet.shared.errors import InvalidInputError, system_errors_as
from nufleet.shared.private_files import write_privately
from nufleet.shared.redaction import without_secrets

if TYPE_CHECKING:
    import pyarrow.parquet

    from nufleet.orchestrator.runs.rank_result import RunRecord
    from nufleet.orchestrator.study.outcomes import Measured
    from nufleet.shared.strict import Strict

D = TypeVar("D", bound="Strict")

RECORDING = "run.rrd"
RESULTS = "results.json"
CONFIGURATION = "config.json"
_STAMP = re.compile(r"^(\d{8}T\d{6}Z)-")
_ELSEWHERE = "; choose another place with --runs"
_PACKAGES = ("nufleet", "eclipse-zenoh", "numpy", "scipy", "numba", "pydantic", "rerun-sdk")


class RunFolder:
    """Writes one run's folder; close it (or leave its `with`) so that the samples are complete.

    Examples:
        >>> with tempfile.TemporaryDirectory() as root:
        ...     with RunFolder(Path(root), "lab") as run:
        ...         run.write_configuration({"kind": "rank", "target": "drone-7"})
        ...     found = find_run(Path(root), "latest")
        ...     found == run.path, sorted(path.name for path in found.iterdir())
        (True, ['config.json'])
    """

    def __init__(
        self, root: Path, name: str, *, now: datetime | None = None, goes_on: bool = False
    ) -> None:
        """Create the folder of a new run, or open that of a resumed one.

        The samples and the recording of a resumed run are rewritten from its stored data.

        Args:
            root: Existing folder of all runs.
            name: Subject of a new run, which becomes part of the folder's name; the whole name of
                the folder of a resumed run.
            now: Time in the name of a new folder; None takes the current time.
            goes_on: Whether the run is resumed, and its folder exists.

        Raises:
            InvalidInputError: The folder cannot be created or written.
        """
        stamp = (now or datetime.now(UTC)).strftime("%Y%m%dT%H%M%SZ")
        self.path = _reopened(root / name) if goes_on else _create(root, f"{stamp}-{name}")
        # A look by `is_in_use`, which excludes this lock, is over at once.
        self._held: int | None = _locked(self.path, fcntl.LOCK_SH)
        self._samples: pyarrow.parquet.ParquetWriter | None = None

    def __enter__(self) -> RunFolder:
        return self

    def __exit__(self, _type: object, error: BaseException | None, _traceback: object) -> None:
        self.close()
        if error is not None and not (self.path / CONFIGURATION).exists():
            # The run was refused before it began, so its folder holds nothing worth keeping.
            shutil.rmtree(self.path)

    @property
    def recording(self) -> Path:
        """Path of the Rerun recording."""
        return self.path / RECORDING

    def close(self) -> None:
        """Complete the file of samples, and hold the folder no longer."""
        samples, self._samples = self._samples, None
        held, self._held = self._held, None
        if samples is not None:
            samples.close()
        if held is not None:
            os.close(held)

    @property
    def study_id(self) -> str:
        """Id of the run's study: its id in the repository and the prefix of its goal ids."""
        return study_id_of(self.path)

    def write_configuration(self, configuration: Mapping[str, Any]) -> None:
        """Write the complete request, and the versions of the software that runs it.

        Args:
            configuration: All settings of the run; secrets in their addresses are not written.
        """
        document = {
            **{
                key: without_secrets(value) if isinstance(value, str) else value
                for key, value in configuration.items()
            },
            "versions": {
                "python": platform.python_version(),
                **{package: version(package) for package in _PACKAGES},
            },
            "command": [without_secrets(word) for word in sys.argv[1:]],
        }
        self._write(CONFIGURATION, json.dumps(document, indent=2, default=str))

    def write_samples(self, iteration: int, measured: Measured) -> None:
        """Append one test's raw samples, so that a better estimator can be run on them later."""
        import numpy as np
        import pyarrow.parquet as pq

        from nufleet.shared.arrays import arrow

        pa = arrow()
        result = measured.result
        count, axes = len(result.reference), [played.axis for played in result.test_plan.played]
        columns = (signal.reshape(count, -1).T for signal in (result.reference, result.response))
        for axis, reference, response in zip(axes, *columns, strict=True):
            table = pa.table(
                {
                    "robot": pa.array([measured.robot] * count).dictionary_encode(),
                    "axis": pa.array([axis] * count).dictionary_encode(),
                    "goal_id": pa.array([result.goal_id] * count).dictionary_encode(),
                    "iteration": np.full(count, iteration, dtype=np.int32),
                    "sample": np.arange(count, dtype=np.int32),
                    "t_s": np.arange(count) * result.plan.sample_time_s,
                    "reference": reference,
                    "response": response,
                }
            )
            if self._samples is None:
                self._samples = pq.ParquetWriter(
                    self.path / "telemetry.parquet", table.schema, compression="zstd"
                )
            self._samples.write_table(table)

    def write_record(self, record: RunRecord) -> None:
        """Write the results of a ranking."""
        self._write(RESULTS, record.model_dump_json(indent=2, by_alias=True, exclude_none=True))

    def write_document(self, name: str, document: Strict) -> None:
        """Write the results of a run that is not a ranking."""
        self._write(name, document.model_dump_json(indent=2, by_alias=True))

    def _write(self, name: str, text: str) -> None:
        """Write a file atomically: a reader finds either all of it or none."""
        write_privately(self.path / name, (text + "\n").encode())


def is_in_use(folder: Path) -> bool:
    """Return whether a command, in this process or another, is working on a run's folder."""
    try:
        os.close(_locked(folder, fcntl.LOCK_EX | fcntl.LOCK_NB))
    except BlockingIOError:
        return True
    return False


def _locked(folder: Path, lock: int) -> int:
    """Lock a folder until the file descriptor that is returned is closed, or the process ends.

    Raises:
        InvalidInputError: The folder cannot be opened.
        BlockingIOError: Another lock excludes this one, and it is not to be waited for.
    """
    with system_errors_as(InvalidInputError, f"{folder} cannot be opened"):
        opened = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
    try:
        fcntl.flock(opened, lock)
    except BaseException:
        os.close(opened)
        raise
    return opened


def study_id_of(folder: Path) -> str:
    """Return the id of the study of a run's folder."""
    return folder.name.lower()


def read_record(folder: Path) -> RunRecord:
    """Return the results in a run's folder; raises InvalidInputError when there are none."""
    from nufleet.orchestrator.runs.rank_result import RunRecord

    record = read_document(folder / RESULTS, RunRecord)
    if record is None:
        raise InvalidInputError(f"there is no {folder / RESULTS}; was the run interrupted?")
    return record


def read_document(path: Path, model: type[D]) -> D | None:
    """Return the document in a file; None if there is no such file.

    Raises:
        InvalidInputError: The file cannot be read, or holds something else.
    """
    from nufleet.shared.strict import validation_errors_as

    with system_errors_as(InvalidInputError, f"{path} cannot be read"):
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            return None
    with validation_errors_as(InvalidInputError, str(path)):
        return model.model_validate_json(data)


def read_configuration(folder: Path) -> dict[str, Any]:
    """Return the configuration in a run's folder; raises InvalidInputError when there is none."""
    path = folder / CONFIGURATION
    with system_errors_as(InvalidInputError, f"{path} cannot be read"):
        data = path.read_bytes()
    try:
        document = json.loads(data)
    except (ValueError, RecursionError) as error:
        raise InvalidInputError(f"{path}: not JSON: {error}") from error
    if not isinstance(document, dict):
        raise InvalidInputError(f"{path}: expected an object")
    return document


def subject_of(folder: Path, configuration: Mapping[str, Any]) -> tuple[str, str, datetime | None]:
    """Return the kind of a run, the name of its fleet, and when it began.

    Args:
        folder: Folder of the run, whose name holds the time unless it was renamed.
        configuration: Configuration of the run.
    """
    kind, fleet = configuration.get("kind", "rank"), configuration.get("fleet")
    stamp = _STAMP.match(folder.name)
    if stamp is None:
        return str(kind), str(fleet or ""), None
    began = datetime.strptime(stamp[1], "%Y%m%dT%H%M%SZ").replace(tzinfo=UTC)
    return str(kind), str(fleet or folder.name[stamp.end() :]), began


def list_runs(root: Path) -> list[Path]:
    """Return the folders of all runs, oldest first."""
    return sorted(path.parent for path in root.glob(f"*/{CONFIGURATION}"))


def find_run(root: Path, run: str) -> Path:
    """Return the folder of a run: given as a path, as a name in the root, or as `latest`."""
    runs = list_runs(root)
    if run == "latest" and runs:
        return runs[-1]
    with system_errors_as(InvalidInputError, f"run {run!r} cannot be read"):
        for candidate in (Path(run), root / run):
            if (candidate / CONFIGURATION).is_file():
                return candidate
    raise InvalidInputError(
        f"no run {run!r}: expected the folder of a run, its name in {root}, or `latest`; "
        "`nufleet runs list` shows all runs"
    )


def make_runs_root(root: Path) -> None:
    """Create the folder of all runs if it is missing, and check that runs can be stored in it.

    A folder that is created here is readable by its user only, like the folder of each run; an
    existing one keeps its permissions.

    Raises:
        InvalidInputError: The folder cannot be created or written.
    """
    with system_errors_as(InvalidInputError, f"runs cannot be stored in {root}", _ELSEWHERE):
        root.mkdir(mode=0o700, parents=True, exist_ok=True)
        with tempfile.TemporaryFile(dir=root):
            pass


def _reopened(path: Path) -> Path:
    with system_errors_as(InvalidInputError, f"{path} cannot be written"):
        (path / RECORDING).unlink(missing_ok=True)
    return path


def _create(root: Path, name: str) -> Path:
    what = f"the run's folder cannot be created in {root}"
    with system_errors_as(InvalidInputError, what, _ELSEWHERE):
        for attempt in range(1, 1000):
            path = root / (name if attempt == 1 else f"{name}-{attempt}")
            try:
                path.mkdir(mode=0o700)
            except FileExistsError:
                continue
            return path
    raise InvalidInputError(f"{root} contains too many runs named {name}")
