"""Converts values to rows of the database and back; rows are validated like any other input."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from datetime import UTC
from functools import lru_cache
from typing import Any

import numpy as np
from pydantic import JsonValue, TypeAdapter, ValidationError
from sqlalchemy import RowMapping

from nufleet.orchestrator.repository.array_blob import pack_array, unpack_complex, unpack_floats
from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.orchestrator.repository.records import (
    ExperienceRecord,
    ResponseRecord,
    RobotRecord,
    StoredExperience,
    StudyRecord,
    StudyStatus,
    TrialEnd,
    TrialIntent,
    TrialRecord,
    TrialStatus,
)
from nufleet.orchestrator.study.interface import StudyPlan
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import MalformedMessageError
from nufleet.shared.experience.file import decode_experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.matrix_response import MatrixResponse
from nufleet.shared.frequency_test.quality import Quality
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Name, Positive, Strict, describe_validation
from nufleet.shared.wire.messages import GoalResult, Outcome

SPECS_KEPT = 1024
"""Number of specs that need not be validated again, since every test of a robot asks for its own.
"""

_PLAN = TypeAdapter(StudyPlan)
_OBJECT = TypeAdapter(dict[str, JsonValue])
_ARCHITECTURE: TypeAdapter[Architecture] = TypeAdapter(Architecture)


def json_object(value: Mapping[str, JsonValue]) -> str:
    """Return a mapping as JSON that preserves numbers bit for bit."""
    return _OBJECT.dump_json(dict(value)).decode()


def robot_record(row: RowMapping) -> RobotRecord:
    """Return the robot in a row."""
    return RobotRecord(
        row["fleet"], row["robot"], spec_of(row["robot"], row["spec"]), row["boot_id"]
    )


@lru_cache(SPECS_KEPT)
def spec_of(robot: str, stored: str) -> RobotSpec:
    """Return the spec of a robot from what is stored of it; raises DamagedRecordError."""
    with checked(f"robot {robot}"):
        return RobotSpec.model_validate_json(stored)


def study_row(study: StudyRecord) -> dict[str, Any]:
    """Return the row of a study."""
    return {
        "study_id": study.study_id,
        "fleet": study.fleet,
        "algorithm": study.algorithm,
        "plan": _PLAN.dump_json(study.plan).decode(),
        "seed": str(study.seed),
        "parameters": json_object(study.parameters),
        "status": study.status,
        "reason": study.reason,
    }


def study_record(row: RowMapping) -> StudyRecord:
    """Return the study in a row."""
    with checked(f"study {row['study_id']}"):
        return StudyRecord(
            study_id=row["study_id"],
            fleet=row["fleet"],
            algorithm=row["algorithm"],
            plan=_PLAN.validate_json(row["plan"]),
            seed=int(row["seed"]),
            parameters=_OBJECT.validate_json(row["parameters"]),
            status=StudyStatus(row["status"]),
            reason=row["reason"],
            result=None if row["result"] is None else _OBJECT.validate_json(row["result"]),
        )


def intent_row(intent: TrialIntent) -> dict[str, Any]:
    """Return the row of a trial that is about to be sent."""
    return {
        **vars(intent),
        "excitation": intent.excitation.model_dump_json(),
        "status": TrialStatus.INTENDED,
        "reason": "",
        "robot_time_s": 0.0,
    }


def end_columns(end: TrialEnd) -> dict[str, Any]:
    """Return the columns of a trial's row that change at its end, but for the time."""
    columns: dict[str, Any] = {
        "status": end.status,
        "reason": end.reason,
        "retry": None if end.retry is None else end.retry.model_dump_json(),
        "interrupted": end.interrupted,
    }
    if end.result is not None:
        # The acceptance that would say the first two may never have arrived.
        columns["boot_id"] = end.result.boot_id
        columns["plan"] = end.result.plan.model_dump_json()
        columns["outcome"] = end.result.outcome
        columns["robot_time_s"] = len(end.result.reference) * end.result.plan.sample_time_s
    return columns


def trial_record(row: RowMapping, response: FrequencyResponse | None) -> TrialRecord:
    """Return the trial in a row."""
    with checked(f"trial {row['goal_id']}"):
        plan, retry, outcome = row["plan"], row["retry"], row["outcome"]
        return TrialRecord(
            intent=TrialIntent(
                goal_id=row["goal_id"],
                study_id=row["study_id"],
                iteration=row["iteration"],
                robot=row["robot"],
                attempt=row["attempt"],
                excitation=Excitation.model_validate_json(row["excitation"]),
                epoch=row["epoch"],
            ),
            status=TrialStatus(row["status"]),
            boot_id=row["boot_id"],
            plan=None if plan is None else ExcitationPlan.model_validate_json(plan),
            outcome=None if outcome is None else Outcome(outcome),
            reason=row["reason"],
            retry=None if retry is None else Excitation.model_validate_json(retry),
            interrupted=bool(row["interrupted"]),
            robot_time_s=row["robot_time_s"],
            response=response,
        )


def goal_result(row: RowMapping) -> GoalResult:
    """Return the robot's result of the trial in a row, which is joined with its samples."""
    trial, goal_id = trial_record(row, None), row["goal_id"]
    shape = (int(row["samples"]), *(() if trial.plan is None else trial.plan.columns))
    with checked(f"the result of goal {goal_id}"):
        return GoalResult.model_validate(
            {
                "goal_id": goal_id,
                "boot_id": trial.boot_id,
                "outcome": trial.outcome,
                "reason": trial.reason[:2000],
                "plan": trial.plan,
                "reference": unpack_floats(row["reference"], shape, f"the reference of {goal_id}"),
                "response": unpack_floats(row["response"], shape, f"the output of {goal_id}"),
            }
        )


def response_row(response: FrequencyResponse) -> dict[str, Any]:
    """Return the columns of a row that hold the response itself."""
    return {
        "tones": len(response.omega_rad_s),
        "omega_rad_s": pack_array(response.omega_rad_s),
        "z": pack_array(response.z),
        "variance": pack_array(response.variance),
        "segments": response.segments,
        "quality": response.quality.model_dump_json(),
        "usable": response.quality.usable,
        "degrees": _packed(response.degrees),
        "amplitude": response.amplitude,
        "hidden_variance": _packed(response.hidden_variance),
    }


def _packed(values: FloatArray | None) -> bytes | None:
    return None if values is None else pack_array(values)


def _unpacked(packed: bytes | None, shape: tuple[int, ...], what: str) -> FloatArray | None:
    return None if packed is None else unpack_floats(packed, shape, what)


class _MatrixAxis(Strict):
    """One axis of a test of several, as it is stored."""

    axis: Name
    """Name of the axis."""
    tones: int
    """Number of its tones."""
    segments: int
    """Number of segments of the test."""
    amplitude: Positive | None
    """Peak of its reference, in its unit."""
    quality: Quality
    """Verdict on its output."""


_AXES = TypeAdapter(tuple[_MatrixAxis, ...])


def matrix_row(matrix: MatrixResponse) -> dict[str, Any]:
    """Return the columns of a row that hold every entry of a test of several axes."""
    rows = matrix.rows
    axes = tuple(
        _MatrixAxis(
            axis=axis,
            tones=int(np.sum(matrix.played_by == place)),
            segments=row.segments,
            amplitude=row.amplitude,
            quality=row.quality,
        )
        for place, (axis, row) in enumerate(zip(matrix.axes, rows, strict=True))
    )
    return {
        "axes": _AXES.dump_json(axes).decode(),
        "all_omega_rad_s": pack_array(rows[0].omega_rad_s),
        "all_z": pack_array(np.stack([row.z for row in rows])),
        "all_variances": pack_array(np.stack([row.variance for row in rows])),
        "all_degrees": pack_array(np.stack([row.degrees_of_freedom for row in rows])),
        "correlation": pack_array(matrix.correlation),
        "all_hidden_variances": _packed(matrix.hidden_variances),
    }


def _matrix_response(row: RowMapping, what: str) -> MatrixResponse | None:
    """Return every entry of the response in a row; None for a test of one axis."""
    if row.get("axes") is None:
        return None
    axes = _AXES.validate_json(row["axes"])
    tones = sum(axis.tones for axis in axes)
    shape = (len(axes), tones)
    omega_rad_s = unpack_floats(row["all_omega_rad_s"], (tones,), what)
    z = unpack_complex(row["all_z"], shape, what)
    variances = unpack_floats(row["all_variances"], shape, what)
    degrees = unpack_floats(row["all_degrees"], shape, what)
    hidden = _unpacked(row["all_hidden_variances"], shape, what)
    return MatrixResponse(
        axes=tuple(axis.axis for axis in axes),
        played_by=np.repeat(np.arange(len(axes)), [axis.tones for axis in axes]),
        rows=tuple(
            FrequencyResponse(
                omega_rad_s=omega_rad_s,
                z=z[place],
                variance=variances[place],
                segments=axis.segments,
                quality=axis.quality,
                degrees=degrees[place],
                amplitude=axis.amplitude,
                hidden_variance=None if hidden is None else hidden[place],
                axis=axis.axis,
            )
            for place, axis in enumerate(axes)
        ),
        correlation=unpack_complex(row["correlation"], (len(axes), len(axes)), what),
    )


def frequency_response(row: RowMapping) -> FrequencyResponse:
    """Return the response in a row, bit for bit as it was stored."""
    what, shape = f"the response of goal {row['goal_id']}", (int(row["tones"]),)
    with checked(what):
        return FrequencyResponse(
            omega_rad_s=unpack_floats(row["omega_rad_s"], shape, what),
            z=unpack_complex(row["z"], shape, what),
            variance=unpack_floats(row["variance"], shape, what),
            segments=row["segments"],
            quality=Quality.model_validate_json(row["quality"]),
            degrees=_unpacked(row["degrees"], shape, what),
            amplitude=row["amplitude"],
            hidden_variance=_unpacked(row["hidden_variance"], shape, what),
            matrix=_matrix_response(row, what),
            axis=row["axis"],
        )


def response_record(row: RowMapping) -> ResponseRecord:
    """Return the response in a row, which is joined with its trial."""
    return ResponseRecord(
        fleet=row["fleet"],
        robot=row["robot"],
        axis=row["axis"],
        goal_id=row["goal_id"],
        study_id=row["study_id"],
        kind=row["kind"] or "",
        measured_at=row["measured_at"].replace(tzinfo=UTC),
        response=frequency_response(row),
    )


def experience_row(record: ExperienceRecord) -> dict[str, Any]:
    """Return the row of an experience, but for its time; raises MalformedMessageError."""
    manifest = decode_experience(record.payload).manifest
    return {
        "fleet": record.fleet,
        "sha256": record.sha256,
        "robot": manifest.robot,
        "architecture": manifest.layout.architecture,
        "manifest": manifest.model_dump_json(),
        "run": record.run,
        "size_bytes": len(record.payload),
        "payload": record.payload,
    }


def stored_experience(row: RowMapping) -> StoredExperience:
    """Return the experience in a row without its file."""
    with checked(f"experience {row['sha256']} of {row['robot']}"):
        return StoredExperience(
            sha256=row["sha256"],
            fleet=row["fleet"],
            robot=row["robot"],
            architecture=_ARCHITECTURE.validate_python(row["architecture"]),
            run=row["run"],
            learned_at=row["learned_at"].replace(tzinfo=UTC),
            size_bytes=row["size_bytes"],
        )


def experience_payload(row: RowMapping) -> bytes:
    """Return the file of the experience in a row, checked like one that a robot sent.

    Raises:
        DamagedRecordError: The file is not the one that was stored, or the other columns do not
            describe it.
    """
    try:
        known = ExperienceRecord(row["fleet"], row["run"], bytes(row["payload"]))
        wrong = [name for name, value in experience_row(known).items() if row[name] != value]
        reason = f"{' and '.join(wrong)} do not match its file" if wrong else None
    except (MalformedMessageError, TypeError) as error:
        reason = str(error)
    if reason is not None:
        raise DamagedRecordError(
            f"experience {row['sha256']} of robot {row['robot']} was altered in the repository: "
            f"{reason}; have the robot learn again with `nufleet train --robot {row['robot']}`, or "
            "restore the repository from a copy"
        )
    return known.payload


@contextmanager
def checked(what: str) -> Iterator[None]:
    """Turn an error in what the database returned into a DamagedRecordError that names it."""
    try:
        yield
    except ValidationError as error:
        raise DamagedRecordError(f"{what}: {describe_validation(error)}") from error
    except (ValueError, TypeError) as error:
        raise DamagedRecordError(f"{what}: {error}") from error
