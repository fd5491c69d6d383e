"""Shows a study as it happens: turns messages of the fleet and the study into viewer events."""

from __future__ import annotations

import cmath
import threading
from collections.abc import Callable, Mapping, Sequence

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.study.interface import Question, Report, StudyPlan
from nufleet.orchestrator.study.outcomes import Measured, TestOutcome
from nufleet.orchestrator.viewer.clock import ViewerClock
from nufleet.orchestrator.viewer.events import (
    LEADERS,
    IterationEvent,
    MessageEvent,
    RobotStateEvent,
    TestSamplesEvent,
    ViewerEvent,
)
from nufleet.shared.arrays import FloatArray
from nufleet.shared.frequency_test.excitation import Excitation
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.wire.messages import RobotState, RobotStatus, Telemetry

_CALM = (RobotStatus.IDLE, RobotStatus.RESTING)


class LiveView:
    """An observer of a study and its fleet that emits viewer events.

    The function `emit` that it is given must never block or raise, since it is called from the
    threads that conduct the study and receive messages.
    """

    def __init__(
        self,
        plan: StudyPlan,
        unit: str,
        clock: ViewerClock,
        emit: Callable[[ViewerEvent], None],
    ) -> None:
        self._plan = plan
        self._unit = unit
        self._clock = clock
        self._emit = emit
        self._lock = threading.Lock()
        self._asked_s = 0.0
        self._tests: Mapping[str, Excitation] = {}
        self._drawn: dict[str, int] = {}
        self._over: set[str] = set()
        self._played_s: dict[str, float] = {}
        self._states: dict[str, RobotState] = {}
        self._lanes: dict[str, str] = {}
        self._unheard: set[str] = set()
        self._watching = False

    def watch(self, fleet: Fleet) -> None:
        """Start to draw the states and running tests of the study's robots."""
        self._watching = True
        fleet.observe_states(self._on_state)
        fleet.observe_telemetry(self._on_telemetry)

    def stop_watching(self) -> None:
        """Stop drawing the fleet: the study is over, and its robots may have other tasks."""
        self._watching = False

    def asked(self, question: Question) -> None:
        """Handle the beginning of a round: its samples are drawn starting at the current time."""
        with self._lock:
            self._asked_s = self._clock.now_s()
            self._tests = question.tests
            self._unheard = set(question.tests)
            self._drawn.clear()
            self._over.clear()

    def attempt_failed(self, robot: str, attempt: int, reason: str) -> None:
        """Log the failed attempt as a warning."""
        text = f"{robot}, attempt {attempt}: {reason}"
        self._emit(MessageEvent(self._clock.now_s(), "warning", text))

    def told(self, question: Question, outcomes: Mapping[str, TestOutcome], report: Report) -> None:
        """Draw the result of a round, and any tests whose telemetry arrived incomplete."""
        measured = [o for o in outcomes.values() if isinstance(o, Measured)]
        for outcome in measured:
            result = outcome.result
            with self._lock:
                missing = self._drawn.get(result.goal_id, 0) < len(result.reference)
                self._over.add(result.goal_id)
                if missing:
                    step_s = result.plan.sample_time_s
                    self._draw(outcome.robot, 0, step_s, result.reference, result.response)
            if (state := self._states.get(outcome.robot)) is not None:
                self._emit_state(state)
        self._unheard.clear()
        omega_rad_s, responses = drawn_of(report, self._plan)
        longest_s = max((o.result.plan.duration_s for o in measured), default=0.0)
        self._clock.advance_to(self._asked_s + longest_s)
        self._emit(
            IterationEvent(
                t_s=self._clock.now_s(),
                iteration=question.iteration,
                omega_rad_s=omega_rad_s,
                responses=responses,
                target=self._plan.target,
                curves=report.curves,
                ranking=report.ranking,
                messages=tuple(f"without {r}: {why}" for r, why in report.dropped.items()),
            )
        )

    def _on_state(self, state: RobotState) -> None:
        if self._watching and state.robot in (self._plan.target, *self._plan.sources):
            self._states[state.robot] = state
            # A simulated robot may be at rest again before the first samples of its test arrive.
            if state.status not in _CALM or state.robot not in self._unheard:
                self._emit_state(state)

    def _emit_state(self, state: RobotState) -> None:
        """Show a state, after the samples that are drawn: a simulated robot outruns the clock."""
        self._lanes[state.robot] = state.status.value
        self._emit(
            RobotStateEvent(
                t_s=max(self._clock.now_s(), self._played_s.get(state.robot, 0.0)),
                robot=state.robot,
                is_target=state.robot == self._plan.target,
                status=state.status.value,
                goal_id=state.goal_id,
                progress=state.progress,
                reason=state.reason,
            )
        )

    def _on_telemetry(self, robot: str, telemetry: Telemetry) -> None:
        if not self._watching or robot not in (self._plan.target, *self._plan.sources):
            return
        first, step_s = telemetry.first_sample, telemetry.sample_time_s
        with self._lock:
            if telemetry.goal_id in self._over:
                return  # samples that come after the whole test was drawn
            drawn = self._drawn.get(telemetry.goal_id, 0) + len(telemetry.reference)
            self._drawn[telemetry.goal_id] = drawn
            self._draw(robot, first, step_s, telemetry.reference, telemetry.response)

    def _draw(
        self,
        robot: str,
        first_sample: int,
        sample_time_s: float,
        reference: FloatArray,
        response: FloatArray,
    ) -> None:
        """Draw the samples of the study's first axis, where a test plays several."""
        played = self._tests[robot].played if robot in self._tests else ()
        tones = {one.axis: one.tones for one in played}
        if tones and self._plan.axis not in tones:
            return
        if reference.ndim == 2:
            column = list(tones).index(self._plan.axis)
            reference, response = reference[:, column], response[:, column]
        begin_s = self._asked_s + first_sample * sample_time_s
        self._unheard.discard(robot)
        self._played_s[robot] = begin_s + len(reference) * sample_time_s
        if self._lanes.get(robot) != "running":
            # The state that says so may be dropped on the way, or come before or after the samples.
            self._lanes[robot] = "running"
            is_target = robot == self._plan.target
            self._emit(RobotStateEvent(begin_s, robot, is_target, "running", None, 0.0, ""))
        self._emit(
            TestSamplesEvent(
                t_s=begin_s,
                robot=robot,
                axis=self._plan.axis,
                unit=self._unit,
                target=self._plan.target,
                robots=tuple(self._tests),
                tones=tones.get(self._plan.axis, ()),
                sample_time_s=sample_time_s,
                reference=reference,
                response=response,
            )
        )


def drawn_of(
    report: Report, plan: StudyPlan
) -> tuple[tuple[float, ...], dict[str, dict[float, complex]]]:
    """Return the latest tones and what is known of the robots that are drawn after a round.

    These are the target, the best sources and all robots that played. Robots may play different
    tones in a round, and sources whose stored responses replace tests play none.

    Args:
        report: Report of the round.
        plan: Plan of the study, whose first axis is drawn.

    Returns:
        Frequencies that the target played in the round in rad/s, rising, or another robot if the
        target rested; and the latest response z(ω) by frequency, by robot.
    """
    played = [_by_tone([one], plan.axis) for one in report.responses.values()]
    if plan.target in report.responses:
        played.insert(0, _by_tone([report.responses[plan.target]], plan.axis))
    leaders = (row.robot for row in report.ranking[:LEADERS])
    known = report.known or {robot: [one] for robot, one in report.responses.items()}
    robots = dict.fromkeys((plan.target, *leaders, *report.responses))
    return tuple(sorted(next(filter(None, played), {}))), {
        robot: _by_tone(known[robot], plan.axis) for robot in robots if robot in known
    }


def _by_tone(responses: Sequence[FrequencyResponse], axis: str) -> dict[float, complex]:
    """Return the latest response of an axis to its own reference, by frequency in rad/s.

    Tones at which nothing could be estimated are left out.
    """
    own = [one.own_entries.get(axis) if one.own_entries else one for one in responses]
    return {
        omega: z
        for one in own
        if one is not None
        for omega, z in zip(one.omega_rad_s.tolist(), one.z.tolist(), strict=True)
        if cmath.isfinite(z)
    }
