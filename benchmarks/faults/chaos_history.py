"""The record of a run under random faults, and the invariants that it has to satisfy."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

from benchmarks.faults.lab import Lab
from benchmarks.faults.logbook import Stretch
from benchmarks.faults.program import Program
from nufleet.orchestrator.repository.records import StudyRecord, StudyStatus, TrialRecord
from nufleet.robot_agent.journal.journal import Journal

HALT_MAX_S = 1.0
"""By then a motion that was in progress when a stop was confirmed has been told to rest, where the
machine is not otherwise busy; everywhere, before the stop is released."""

MAY_BE_GIVEN_UP = (
    "stopped by",
    "the agent process",  # ... ended during it, three times
    "did not return",  # within its patience: a machine that is too busy to start an agent
    "not finite at sample",
    "got no sample",
)
"""Why a study may continue without a robot, in the words of the reasons for it."""


@dataclass(frozen=True)
class Stop:
    """A stop that a robot confirmed, when its release was begun and granted; None if it was not."""

    robot: str
    confirmed_s: float
    released_s: float | None
    granted_s: float | None = None


@dataclass
class History:
    """Everything that was recorded; read once all programs have ended."""

    lab: Lab
    target: str
    undisturbed: object
    programs: Sequence[Program]
    studies: Sequence[StudyRecord] = ()
    trials: Sequence[TrialRecord] = ()
    stops: list[Stop] = field(default_factory=list)
    faults: dict[str, int] = field(default_factory=dict)
    halt_max_s: float = HALT_MAX_S

    @property
    def complete(self) -> list[StudyRecord]:
        """The studies that came to an end with a ranking."""
        return [study for study in self.studies if study.status is StudyStatus.COMPLETE]

    @property
    def whole(self) -> list[StudyRecord]:
        """The complete studies that lost no robot: they all have the same data."""
        return [s for s in self.complete if s.result is not None and not s.result["dropped"]]

    def violations(self) -> list[str]:
        """Return what should not have been; nothing when all is well."""
        return [
            *self._trials_end(),
            *self._rankings(),
            *self._losses(),
            *self._errors(),
            *(found for robot in self.lab.robots for found in self._of_robot(robot)),
        ]

    def _trials_end(self) -> Iterator[str]:
        over = {study.study_id for study in self.studies if study.status is not StudyStatus.OPEN}
        for trial in self.trials:
            if trial.intent.study_id in over and not trial.status.ended:
                yield f"trial {trial.intent.goal_id} never ended"

    def _rankings(self) -> Iterator[str]:
        for study in self.whole:
            if study.result is not None and study.result["ranking"] != self.undisturbed:
                yield f"{study.study_id} came to {study.result['ranking']}"

    def _losses(self) -> Iterator[str]:
        """A robot may be given up for what was done to it, and for nothing that the network did."""
        for study in self.complete:
            dropped = {} if study.result is None else dict(study.result["dropped"])  # type: ignore[arg-type]
            for robot, reason in dropped.items():
                if not any(words in str(reason) for words in MAY_BE_GIVEN_UP):
                    yield f"{study.study_id} gave {robot} up: {reason}"
        for study in self.studies:
            excused = any(words in study.reason for words in MAY_BE_GIVEN_UP)
            if study.status is StudyStatus.FAILED and not excused:
                yield f"{study.study_id} could not continue: {study.reason}"

    def _errors(self) -> Iterator[str]:
        for program in self.programs:
            for word in ("Traceback", "internal-error", "panicked"):
                if word in program.said:
                    at = program.said.index(word)
                    yield f"{program.what} said: {program.said[max(0, at - 300) : at + 1500]}"

    def _of_robot(self, robot: str) -> Iterator[str]:
        motions = self.lab.motions(robot)
        with Journal(self.lab.journal(robot)) as journal:
            goals = list(journal.remembrance.goals.known)
        intents = {trial.intent.goal_id: trial.intent for trial in self.trials}
        if len(motions) > len(goals):
            yield f"{robot} moved {len(motions)} times for {len(goals)} goals"
        if unknown := set(goals) - set(intents):
            yield f"{robot} took goals of which no intent is stored: {sorted(unknown)}"
        epochs = [intents[goal].epoch for goal in goals if goal in intents]
        if epochs != sorted(epochs):
            yield f"{robot} obeyed an epoch that was over: {epochs}"
        yield from self._of_stops(robot, motions)

    def _of_stops(self, robot: str, motions: Sequence[Stretch]) -> Iterator[str]:
        for stop in (stop for stop in self.stops if stop.robot == robot):
            until_s = float("inf") if stop.released_s is None else stop.released_s
            for motion in motions:
                if stop.confirmed_s < motion.began_s < until_s:
                    yield f"{robot} moved at {motion.began_s:.3f} while {stop}"
                granted_s = float("inf") if stop.granted_s is None else stop.granted_s
                halted_s = min(granted_s, stop.confirmed_s + self.halt_max_s)
                if motion.began_s < stop.confirmed_s and halted_s < (motion.ended_s or 0.0):
                    yield f"{robot} moved on until {motion.ended_s:.3f} after {stop}"
