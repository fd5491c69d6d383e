"""Stores studies, their trials, and the responses and samples that the trials produced."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from typing import Any

from pydantic import JsonValue
from sqlalchemy import Connection, bindparam, or_, select
from sqlalchemy.sql.dml import ReturningUpdate

from nufleet.orchestrator.repository.array_blob import pack_array
from nufleet.orchestrator.repository.database import Database
from nufleet.orchestrator.repository.errors import RecordConflictError, UnknownRecordError
from nufleet.orchestrator.repository.flight_store import flown_response
from nufleet.orchestrator.repository.records import (
    ResponseRecord,
    StudyRecord,
    StudyStatus,
    TrialEnd,
    TrialIntent,
    TrialRecord,
    TrialStatus,
)
from nufleet.orchestrator.repository.rows import (
    end_columns,
    frequency_response,
    goal_result,
    intent_row,
    json_object,
    matrix_row,
    response_record,
    response_row,
    spec_of,
    study_record,
    study_row,
    trial_record,
)
from nufleet.orchestrator.repository.tables import (
    MATRICES,
    RESPONSES,
    ROBOTS,
    SAMPLES,
    STUDIES,
    TRIALS,
    utc_now,
)
from nufleet.orchestrator.repository.trial_rules import (
    check_epoch,
    check_same_intent,
    is_new_acceptance,
    is_new_end,
)
from nufleet.orchestrator.repository.upsert import insert_new
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.wire.messages import GoalAccepted, GoalResult


class StudyStore:
    """The store of studies; every call is one transaction, which stores everything or nothing."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def begin(self, study: StudyRecord) -> None:
        """Store a study before its first question; raises RecordConflictError if it exists."""
        with self._database.write() as connection:
            connection.execute(STUDIES.insert().values(**study_row(study), begun_at=utc_now()))

    def end(
        self,
        study_id: str,
        status: StudyStatus,
        reason: str = "",
        result: Mapping[str, JsonValue] | None = None,
    ) -> None:
        """Store that a study has ended, or that it is open again because it is resumed.

        Args:
            study_id: Id of the study.
            status: New status.
            reason: Reason why it ended.
            result: Document that the study printed, if it is complete.
        """
        document = None if result is None else json_object(result)
        values = {"status": status, "reason": reason, "result": document}
        update = STUDIES.update().where(STUDIES.c.study_id == study_id).values(values)
        with self._database.write() as connection:
            found = connection.execute(update).rowcount
        if not found:
            raise UnknownRecordError(f"there is no study {study_id}")

    def reopen(self, study_id: str, goal_ids: Sequence[str]) -> None:
        """Store that a study which has failed continues, with new attempts at some of its tests.

        Args:
            study_id: Id of the study.
            goal_ids: Goals of the trials that were given up and are to be repeated.
        """
        again = TRIALS.update().where(TRIALS.c.goal_id.in_(goal_ids))
        again = again.values(retry=TRIALS.c.excitation, interrupted=True)
        opened = STUDIES.update().where(STUDIES.c.study_id == study_id)
        with self._database.write() as connection:
            connection.execute(again)
            connection.execute(opened.values(status=StudyStatus.OPEN, reason=""))

    def study(self, study_id: str) -> StudyRecord:
        """Return a study; raises UnknownRecordError."""
        query = select(STUDIES).where(STUDIES.c.study_id == study_id)
        row = self._database.row(query)
        if row is None:
            raise UnknownRecordError(f"there is no study {study_id}")
        return study_record(row)

    def studies(self, status: StudyStatus | None = None) -> tuple[StudyRecord, ...]:
        """Return all studies, or those with the given status, oldest first."""
        query = select(STUDIES).order_by(STUDIES.c.begun_at, STUDIES.c.study_id)
        if status is not None:
            query = query.where(STUDIES.c.status == status)
        return tuple(map(study_record, self._database.rows(query)))

    def intend(self, *intents: TrialIntent) -> tuple[TrialRecord, ...]:
        """Store the intent to send tests, and return the trial of each as it is stored.

        Raises:
            RecordConflictError: An id or a place in the study is taken by another test.
            StaleEpochError: A later owner has taken over a trial.
            UnknownRecordError: There is no such study.
        """
        if not intents:
            return ()
        rows = [{**intent_row(intent), "intended_at": utc_now()} for intent in intents]
        with self._database.write() as connection:
            if connection.execute(insert_new(connection, TRIALS), rows).rowcount == len(rows):
                return tuple(TrialRecord(intent, TrialStatus.INTENDED) for intent in intents)
            return tuple(_known_intent(connection, intent) for intent in intents)

    def accepted(self, accepted: GoalAccepted, *, epoch: int) -> None:
        """Store that a robot accepted a goal; raises TrialEndedError or StaleEpochError."""

        def work(connection: Connection) -> None:
            values = {
                "status": TrialStatus.ACCEPTED,
                "boot_id": accepted.boot_id,
                "plan": accepted.plan.model_dump_json(),
            }
            if _change(connection, _ACCEPT, accepted.goal_id, epoch, values) is None:
                is_new_acceptance(_known(connection, accepted.goal_id, epoch), accepted.boot_id)

        self._database.write_together(work)

    def ending(self) -> AbstractContextManager[None]:
        """Return a context in which to prepare the end of a trial, for `ended`."""
        return self._database.announced_write()

    def ended(self, goal_id: str, end: TrialEnd, *, epoch: int) -> None:
        """Store how a trial ended, with the data that it gave.

        Args:
            goal_id: Id of the trial's goal.
            end: End of the trial, with its data.
            epoch: Epoch under which the trial was sent.

        Raises:
            TrialEndedError: The trial has ended in another way.
            StaleEpochError: A later owner has taken over the trial.
        """

        def work(connection: Connection) -> None:
            values = {"ended_at": utc_now(), **end_columns(end)}
            changed = _change(connection, _END, goal_id, epoch, values)
            if changed is None:
                is_new_end(_known(connection, goal_id, epoch), end.status)
            elif end.result is not None:
                _keep(connection, *changed, end.result, end.response)

        self._database.write_together(work)

    def trials(self, study_id: str) -> tuple[TrialRecord, ...]:
        """Return the trials of a study by iteration, robot and attempt, with their responses."""
        order = (TRIALS.c.iteration, TRIALS.c.robot, TRIALS.c.attempt)
        query = select(TRIALS).where(TRIALS.c.study_id == study_id).order_by(*order)
        measured = _RESPONSES.where(TRIALS.c.study_id == study_id)
        with self._database.read() as connection:  # one transaction, so that both fit together
            rows = connection.execute(query).mappings().all()
            found = connection.execute(measured).mappings().all()
        responses = {row["goal_id"]: frequency_response(row) for row in found}
        return tuple(trial_record(row, responses.get(row["goal_id"])) for row in rows)

    def result(self, goal_id: str) -> GoalResult:
        """Return the result that a robot returned for a trial, with its raw samples.

        Raises:
            UnknownRecordError: No result of this trial is stored.
            DamagedRecordError: The stored result was altered.
        """
        join = TRIALS.join(SAMPLES)
        query = select(TRIALS, SAMPLES.c.samples, SAMPLES.c.reference, SAMPLES.c.response)
        query = query.select_from(join).where(TRIALS.c.goal_id == goal_id)
        row = self._database.row(query)
        if row is None:
            raise UnknownRecordError(f"no samples of goal {goal_id} are stored")
        return goal_result(row)

    def forget_samples(self, run_id: str) -> int:
        """Delete the samples of all studies that a run conducted; return how many tests had some.

        Args:
            run_id: Id of the run: that of its study, or the first part, before a dot, of several.
        """
        of_run = or_(
            TRIALS.c.study_id == run_id, TRIALS.c.study_id.startswith(f"{run_id}.", autoescape=True)
        )
        tests = select(TRIALS.c.goal_id).where(of_run)
        with self._database.write() as connection:
            return connection.execute(SAMPLES.delete().where(SAMPLES.c.goal_id.in_(tests))).rowcount

    def responses(
        self, fleet: str, robot: str, axis: str, *, usable: bool = True
    ) -> tuple[ResponseRecord, ...]:
        """Return the responses of a robot's axis from all studies, oldest first.

        Args:
            fleet: Name of the fleet.
            robot: Name of the robot.
            axis: Name of the axis.
            usable: Whether to return the usable responses or, instead, the unusable ones.
        """
        query = _RESPONSES.where(RESPONSES.c.fleet == fleet, RESPONSES.c.robot == robot)
        query = query.where(RESPONSES.c.axis == axis, RESPONSES.c.usable == usable)
        return tuple(map(response_record, self._database.rows(query)))

    def response(self, goal_id: str) -> ResponseRecord:
        """Return the response of that id, of a goal or a flight; raises UnknownRecordError."""
        query = _RESPONSES.where(RESPONSES.c.goal_id == goal_id)
        row = self._database.row(query)
        found = flown_response(self._database, goal_id) if row is None else response_record(row)
        if found is None:
            raise UnknownRecordError(f"no response of goal {goal_id} is stored")
        return found


_RESPONSES = (
    select(RESPONSES, TRIALS.c.study_id, *(c for c in MATRICES.c if c.name != "goal_id"))
    .select_from(
        RESPONSES.join(TRIALS).outerjoin(MATRICES, MATRICES.c.goal_id == RESPONSES.c.goal_id)
    )
    .order_by(RESPONSES.c.measured_at, RESPONSES.c.goal_id)
)


def _known_intent(connection: Connection, intent: TrialIntent) -> TrialRecord:
    """Return the trial of an intent, which was there before or has just been stored."""
    known = _locked(connection, intent.goal_id)
    if known is None:
        raise RecordConflictError(
            f"study {intent.study_id} already has an attempt {intent.attempt} of {intent.robot} in "
            f"iteration {intent.iteration}, under an id other than {intent.goal_id}"
        )
    check_same_intent(known, intent)
    connection.execute(_UPDATE, {"id": intent.goal_id, "epoch": intent.epoch})
    return TrialRecord(intent, known.status, known.boot_id, known.plan)


def _locked(connection: Connection, goal_id: str) -> TrialRecord | None:
    """Return a trial without its response, locked until the transaction ends."""
    row = connection.execute(_LOCKED, {"id": goal_id}).mappings().one_or_none()
    return None if row is None else trial_record(row, None)


def _known(connection: Connection, goal_id: str, epoch: int) -> TrialRecord:
    known = _locked(connection, goal_id)
    if known is None:
        raise UnknownRecordError(f"no intent of goal {goal_id} is stored")
    check_epoch(known, epoch)
    return known


def _change(
    connection: Connection,
    statement: ReturningUpdate[tuple[str, str]],
    goal_id: str,
    epoch: int,
    values: Mapping[str, Any],
) -> tuple[str, str] | None:
    """Change a trial and return its study and robot; None, without a change, if it may not be.

    This is nearly always all there is to do. Which rule of `trial_rules` it would break is found
    out only then, since reading a trial takes several times as long.
    """
    row = connection.execute(statement, {"id": goal_id, "by": epoch, **values}).one_or_none()
    return None if row is None else (row.study_id, row.robot)


def _keep(
    connection: Connection,
    study_id: str,
    robot: str,
    result: GoalResult,
    response: FrequencyResponse | None,
) -> None:
    """Store the samples of a trial, and the response that was estimated from them."""
    goal_id = result.goal_id
    samples = {
        "goal_id": goal_id,
        "samples": len(result.reference),
        "reference": pack_array(result.reference),
        "response": pack_array(result.response),
    }
    connection.execute(_KEEP_SAMPLES, samples)
    if response is None:
        return
    described = connection.execute(_DESCRIBED, {"study": study_id, "name": robot}).one_or_none()
    if described is None:
        raise UnknownRecordError(f"no description of robot {robot} of study {study_id} is stored")
    measured = {
        "goal_id": goal_id,
        "fleet": described.fleet,
        "robot": robot,
        "axis": result.test_plan.axis,
        "measured_at": utc_now(),
        "kind": spec_of(robot, described.spec).kind,
        **response_row(response),
    }
    connection.execute(_KEEP_RESPONSE, measured)
    if response.matrix is not None:
        connection.execute(_KEEP_MATRIX, {"goal_id": goal_id, **matrix_row(response.matrix)})


# Statements that every test of every robot executes; building one takes longer than executing it,
# so each is built once.
_LOCKED = select(TRIALS).where(TRIALS.c.goal_id == bindparam("id")).with_for_update()
_UPDATE = TRIALS.update().where(TRIALS.c.goal_id == bindparam("id"))
_OF_OWNER = _UPDATE.where(TRIALS.c.epoch <= bindparam("by"))
_ACCEPT = _OF_OWNER.where(TRIALS.c.status == TrialStatus.INTENDED).returning(
    TRIALS.c.study_id, TRIALS.c.robot
)
_END = _OF_OWNER.where(TRIALS.c.status.not_in([s for s in TrialStatus if s.ended])).returning(
    TRIALS.c.study_id, TRIALS.c.robot
)
_KEEP_SAMPLES = SAMPLES.insert()
_KEEP_RESPONSE = RESPONSES.insert()
_KEEP_MATRIX = MATRICES.insert()
_DESCRIBED = (
    select(ROBOTS.c.fleet, ROBOTS.c.spec)
    .join(STUDIES, STUDIES.c.fleet == ROBOTS.c.fleet)
    .where(STUDIES.c.study_id == bindparam("study"), ROBOTS.c.robot == bindparam("name"))
)
