"""What follows from the end of an attempt: stored first, repeated within what the robot accepts."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from puppet_robot import puppet_spec

from nufleet.orchestrator.conduct.attempts import (
    ATTEMPTS,
    ATTEMPTS_IN_ALL,
    Attempts,
    Settled,
    estimated,
    retried,
    without_the_expected,
)
from nufleet.orchestrator.conduct.replay import OpenTest, goal_id_of
from nufleet.orchestrator.fleet.goal_events import Ended
from nufleet.orchestrator.repository.errors import RepositoryError
from nufleet.orchestrator.repository.records import TrialEnd, TrialIntent, TrialRecord, TrialStatus
from nufleet.orchestrator.study.outcomes import Failed, Measured
from nufleet.robot_agent.motion.excitation import plan_excitation, reference_of
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import NoReplyError, NufleetError, RefusedError, RobotLostError
from nufleet.shared.frequency_test.duration import duration_s
from nufleet.shared.frequency_test.excitation import AxisTones, Excitation, ExcitationPlan, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse
from nufleet.shared.frequency_test.quality import Finding, Quality
from nufleet.shared.frequency_test.timing import Timing
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.wire.messages import GoalResult, Outcome

STUDY = "study"
TEST = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),))


@dataclass(frozen=True)
class Stored:
    """One end of an attempt, as it was stored."""

    how: str
    goal_id: str
    reason: str = ""
    retry: Excitation | None = None
    interrupted: bool = False
    samples: int | None = None


@dataclass
class InMemory:
    """Remembers what is stored."""

    study_id: str = STUDY
    stored: list[Stored] = field(default_factory=list)

    def ended(self, test: OpenTest, end: TrialEnd) -> None:
        if end.status is TrialStatus.MEASURED:
            assert end.response is not None
            assert end.response.quality.usable
        samples = None if end.result is None else len(end.result.response)
        self.stored.append(
            Stored(end.status, test.goal_id, end.reason, end.retry, end.interrupted, samples)
        )


def a_test(
    excitation: Excitation = TEST,
    *,
    attempt: int = 1,
    failures: int = 0,
    accepted_by: str | None = None,
    sent_before: bool = False,
) -> OpenTest:
    goal_id = goal_id_of(STUDY, 1, "r1", attempt)
    record = None
    if sent_before or accepted_by is not None:
        intent = TrialIntent(goal_id, STUDY, 1, "r1", attempt, excitation, epoch=1)
        status = TrialStatus.INTENDED if accepted_by is None else TrialStatus.ACCEPTED
        record = TrialRecord(intent, status, boot_id=accepted_by)
    return OpenTest(goal_id, 1, "r1", attempt, excitation, record, failures)


def played(
    test: OpenTest,
    spec: RobotSpec | None = None,
    *,
    measure: Callable[[FloatArray], FloatArray] = np.copy,
    outcome: Outcome = Outcome.COMPLETED,
) -> GoalResult:
    """What a robot returns that follows perfectly and whose sensor says what `measure` makes."""
    plan = plan_excitation(test.excitation, spec or puppet_spec(), "r1")
    reference = reference_of(plan)
    if outcome is not Outcome.COMPLETED:
        reference = reference[:5] if outcome is not Outcome.LOST else reference[:0]
    return GoalResult(
        goal_id=test.goal_id,
        boot_id="boot",
        outcome=outcome,
        reason="" if outcome is Outcome.COMPLETED else f"because of {outcome}",
        plan=plan,
        reference=reference,
        response=measure(reference),
    )


def attempts(log: InMemory, spec: RobotSpec | None = None) -> Attempts:
    return Attempts(log, {"r1": spec or puppet_spec()})


def settle(log: InMemory, test: OpenTest, ended: Ended, *, interrupted: bool = False) -> Settled:
    return attempts(log).settle(test, ended, interrupted=interrupted)


# Answers.


def test_a_usable_response_is_stored_and_is_the_answer() -> None:
    log, test = InMemory(), a_test()
    result = played(test)
    settled = settle(log, test, Ended(result=result))
    assert isinstance(settled.outcome, Measured)
    assert settled.outcome.response.z[0] == pytest.approx(1.0, abs=1e-9)
    assert (settled.outcome.attempts, settled.following, settled.failure) == (1, None, None)
    assert settled.outcome.robot_time_s == pytest.approx(result.plan.duration_s)
    assert log.stored == [Stored("measured", test.goal_id, samples=len(result.response))]


def test_one_that_is_not_usable_is_repeated_with_more_time() -> None:
    log, test = InMemory(), a_test()
    result = played(test, measure=np.zeros_like)
    settled = settle(log, test, Ended(result=result))
    assert settled.outcome is None
    assert settled.failure
    following = settled.following
    assert following is not None
    assert (following.attempt, following.failures) == (2, 1)
    assert following.goal_id != test.goal_id
    longer_s = duration_s(following.excitation, puppet_spec())
    assert longer_s == pytest.approx(2 * result.plan.duration_s, rel=0.2)
    (stored,) = log.stored
    assert (stored.how, stored.retry) == ("failed", following.excitation)
    assert stored.samples == len(result.response), "the samples of a bad test are kept too"


def test_the_robot_time_of_all_attempts_counts() -> None:
    log, first = InMemory(), a_test()
    conducting = attempts(log)
    bad = played(first, measure=np.zeros_like)
    following = conducting.settle(first, Ended(result=bad), interrupted=False).following
    assert following is not None
    good = played(following)
    settled = conducting.settle(following, Ended(result=good), interrupted=False)
    assert isinstance(settled.outcome, Measured)
    both_s = bad.plan.duration_s + good.plan.duration_s
    assert settled.outcome.robot_time_s == pytest.approx(both_s)


# Failures.


def test_a_robot_that_keeps_failing_is_given_up_after_so_many_attempts() -> None:
    log = InMemory()
    conducting = attempts(log)
    test: OpenTest | None = a_test()
    settled = Settled()
    while test is not None:
        failed = played(test, outcome=Outcome.FAILED)
        settled = conducting.settle(test, Ended(result=failed), interrupted=False)
        test = settled.following
    assert isinstance(settled.outcome, Failed)
    assert settled.outcome.attempts == ATTEMPTS
    assert settled.outcome.reason == settled.failure == "failed: because of failed"
    assert [stored.retry for stored in log.stored] == [TEST, TEST, None]


@pytest.mark.parametrize("outcome", [Outcome.FAILED, Outcome.CANCELLED, Outcome.LOST])
def test_what_ends_early_by_itself_counts_against_its_robot(outcome: Outcome) -> None:
    log, test = InMemory(), a_test()
    settled = settle(log, test, Ended(result=played(test, outcome=outcome)))
    assert settled.following is not None
    assert (settled.following.failures, settled.following.excitation) == (1, TEST)
    assert not log.stored[0].interrupted


@pytest.mark.parametrize(
    ("outcome", "sent_before"),
    [
        (Outcome.ABORTED, False),
        (Outcome.ABORTED, True),
        (Outcome.CANCELLED, True),
        (Outcome.LOST, True),
    ],
)
def test_what_others_ended_is_repeated_and_no_failure(outcome: Outcome, sent_before: bool) -> None:
    log, test = InMemory(), a_test(failures=ATTEMPTS - 1, sent_before=sent_before)
    settled = settle(log, test, Ended(result=played(test, outcome=outcome)))
    assert settled.following is not None
    assert settled.following.failures == ATTEMPTS - 1
    assert log.stored[0].interrupted


def test_not_even_excuses_go_on_for_ever() -> None:
    log, test = InMemory(), a_test(attempt=ATTEMPTS_IN_ALL)
    settled = settle(log, test, Ended(result=played(test, outcome=Outcome.ABORTED)))
    assert isinstance(settled.outcome, Failed)
    assert log.stored[0].retry is None


def test_a_refusal_is_final_and_its_reason_is_the_robots() -> None:
    log, test = InMemory(), a_test()
    error = RefusedError("amplitude", "at most 1 m", "r1")
    settled = settle(log, test, Ended(error=error))
    assert isinstance(settled.outcome, Failed)
    assert (settled.outcome.reason, settled.outcome.attempts) == (str(error), 1)
    assert (settled.following, settled.failure) == (None, None)
    assert log.stored == [Stored("failed", test.goal_id, str(error))]


@pytest.mark.parametrize("error", [RobotLostError("it is gone"), NoReplyError("no answer")])
def test_a_robot_that_is_lost_is_tried_again_as_often_as_one_that_fails(
    error: NufleetError,
) -> None:
    log, test = InMemory(), a_test()
    for failures in range(1, ATTEMPTS):
        settled = settle(log, test, Ended(error=error, abandoned=(test.goal_id,)))
        assert settled.following is not None
        assert (settled.failure, settled.following.failures) == (str(error), failures)
        test = settled.following
    settled = settle(log, test, Ended(error=error, abandoned=(test.goal_id,)))
    assert isinstance(settled.outcome, Failed)
    assert [stored.how for stored in log.stored] == ["lost"] * ATTEMPTS


def test_one_that_was_lost_with_the_orchestrator_before_is_excused() -> None:
    log, test = InMemory(), a_test(failures=ATTEMPTS - 1, accepted_by="boot")
    settled = settle(log, test, Ended(error=RobotLostError("it is gone")))
    assert settled.following is not None
    assert settled.following.failures == ATTEMPTS - 1
    assert log.stored[0].interrupted


def test_an_end_that_cannot_be_stored_is_followed_by_nothing() -> None:
    class Full(InMemory):
        def ended(self, *_: object) -> None:
            raise RepositoryError("no room is left")

    test = a_test()
    with pytest.raises(RepositoryError, match="no room"):
        settle(Full(), test, Ended(result=played(test, measure=np.zeros_like)))


# Interrupted rounds.


def test_an_interrupted_round_stores_what_was_measured() -> None:
    log, test = InMemory(), a_test()
    settled = settle(log, test, Ended(result=played(test)), interrupted=True)
    assert isinstance(settled.outcome, Measured)
    assert [stored.how for stored in log.stored] == ["measured"]


@pytest.mark.parametrize("outcome", [Outcome.CANCELLED, Outcome.ABORTED, Outcome.LOST])
def test_an_interrupted_round_stores_results_excuses_robots_and_intends_nothing(
    outcome: Outcome,
) -> None:
    log, test = InMemory(), a_test()
    settled = settle(log, test, Ended(result=played(test, outcome=outcome)), interrupted=True)
    assert settled == Settled()
    (stored,) = log.stored
    assert (stored.how, stored.interrupted, stored.retry) == ("failed", True, TEST)
    assert stored.samples is not None


def test_what_nobody_knows_the_end_of_is_left_open_for_who_resumes() -> None:
    log, test = InMemory(), a_test()
    for ended in (
        Ended(interrupted=True),
        Ended(error=RobotLostError("gone"), interrupted=True, abandoned=(test.goal_id,)),
    ):
        assert settle(log, test, ended, interrupted=True) == Settled()
    assert log.stored == []


# Longer tests.


def test_a_long_test_with_one_bad_reading_is_repeated_within_what_its_robot_accepts() -> None:
    spec = puppet_spec().model_copy(update={"duration_max_s": 100.0})
    test = a_test(Excitation(axis="x", tones=(Tone(omega_rad_s=0.5),), settle_s=2.5))
    assert 60.0 < duration_s(test.excitation, spec) < 66.0
    log = InMemory()
    conducting = attempts(log, spec)
    bad = played(test, spec, measure=np.zeros_like)
    settled = conducting.settle(test, Ended(result=bad), interrupted=False)
    following = settled.following
    assert following is not None
    again = played(following, spec)  # it is accepted
    assert 80.0 < again.plan.duration_s <= 100.0
    settled = conducting.settle(following, Ended(result=again), interrupted=False)
    assert isinstance(settled.outcome, Measured)


def test_a_test_as_long_as_its_robot_accepts_is_repeated_as_it_is() -> None:
    excitation = Excitation(axis="x", tones=(Tone(omega_rad_s=0.5),))
    longest_s = duration_s(excitation, puppet_spec())
    spec = puppet_spec().model_copy(update={"duration_max_s": longest_s})
    plan = plan_excitation(excitation, spec, "r1")
    assert retried(excitation, plan, failed("unsettled"), spec) == excitation


def failed(code: str) -> Quality:
    return Quality(reasons=(Finding(code=code, text="it went wrong"),))


def test_what_saturated_is_repeated_at_half_the_amplitude() -> None:
    excitation = Excitation(axis="x", tones=(Tone(omega_rad_s=2.0),))
    plan = plan_excitation(excitation, puppet_spec(), "r1")
    again = retried(excitation, plan, failed("clipped"), puppet_spec())
    assert again == excitation.model_copy(update={"amplitude": plan.amplitude / 2})


@pytest.mark.parametrize("amplitude", [None, 0.01])
def test_what_noise_hid_is_repeated_for_longer_and_no_larger_than_was_asked_for(
    amplitude: float | None,
) -> None:
    excitation = Excitation(axis="x", tones=(Tone(omega_rad_s=2.0),), amplitude=amplitude)
    plan = plan_excitation(excitation, puppet_spec(), "r1")
    again = retried(excitation, plan, failed("uncertain"), puppet_spec())
    assert again.amplitude == amplitude
    longer = plan_excitation(again, puppet_spec(), "r1")
    assert longer.segment_samples == pytest.approx(2 * plan.segment_samples, abs=1)


def test_what_noise_hid_at_all_tones_is_repeated_at_the_lower_ones_which_may_be_larger() -> None:
    of_x, of_y = np.geomspace(0.5, 9.0, 10).tolist(), np.geomspace(0.6, 8.0, 3).tolist()
    also = AxisTones(axis="y", tones=tuple(Tone(omega_rad_s=omega) for omega in of_y))
    tones = tuple(Tone(omega_rad_s=omega) for omega in reversed(of_x))
    excitation = Excitation(axis="x", tones=tones, also=(also,))
    slow = tuple(a.model_copy(update={"acceleration_max": 4.0}) for a in puppet_spec().axes)
    spec = puppet_spec().model_copy(update={"axes": slow})
    plan = plan_excitation(excitation, spec, "r1")
    again = retried(excitation, plan, failed("uncertain"), spec)
    assert again.omega_rad_s == tuple(sorted([*of_x[:5], *of_y[:2]]))
    assert plan_excitation(again, spec, "r1").amplitude > 2 * plan.amplitude


@st.composite
def accepted_tests(draw: st.DrawFn) -> tuple[Excitation, RobotSpec, ExcitationPlan]:
    sample_time_s = draw(st.sampled_from([0.001, 0.01, 0.02, 0.1]))
    omega_max_rad_s = 0.9 * np.pi / sample_time_s
    spec = puppet_spec().model_copy(
        update={
            "sample_time_s": sample_time_s,
            "omega_max_rad_s": omega_max_rad_s,
            "settling_time_s": draw(st.sampled_from([0.0, 0.3, 5.0])),
            "duration_max_s": draw(st.floats(0.5, 3000.0)),
        }
    )
    omegas = draw(
        st.lists(st.floats(0.02, min(50.0, omega_max_rad_s)), min_size=1, max_size=4, unique=True)
    )
    excitation = Excitation(
        axis="x",
        tones=tuple(Tone(omega_rad_s=omega) for omega in omegas),
        segments=draw(st.integers(3, 8)),
        segment_min_s=draw(st.just(0.0) | st.floats(0.0, 60.0)),
        settle_s=draw(st.none() | st.floats(0.0, 60.0)),
    )
    try:
        return excitation, spec, plan_excitation(excitation, spec, "r1")
    except RefusedError:
        assume(False)
        raise


@given(accepted_test=accepted_tests())
def test_a_repeated_test_is_no_shorter_and_accepted_if_the_first_was(
    accepted_test: tuple[Excitation, RobotSpec, ExcitationPlan],
) -> None:
    excitation, spec, plan = accepted_test
    longer = retried(excitation, plan, failed("unsettled"), spec)
    assert Excitation.model_validate(longer.model_dump()) == longer
    again = plan_excitation(longer, spec, "r1")
    assert again.duration_s <= spec.duration_max_s
    assert again.samples >= plan.samples


def test_a_clock_that_is_not_known_exactly_widens_the_response_of_its_test() -> None:
    result = played(a_test())
    times = {"period_s": 0.01, "jitter_std_s": 0.0, "gap_max_s": 0.01, "unmeasured": 0.0}
    dated = result.model_copy(update={"timing": Timing(**times, clock_std_s=1e-3)})
    exact, rough = estimated(result), estimated(dated)
    np.testing.assert_allclose(rough.variance - exact.variance, (20.0 * 1e-3) ** 2, rtol=1e-3)
    assert rough.z == exact.z


def test_an_unknown_delay_widens_responses_unless_all_robots_are_measured_alike() -> None:
    def spec(measurement: str, delay_uncertainty_s: float = 0.0) -> RobotSpec:
        changes = {"measurement": measurement, "delay_uncertainty_s": delay_uncertainty_s}
        return puppet_spec().model_copy(update=changes)

    def variance(**specs: RobotSpec) -> float:
        test = a_test()
        each = Attempts(InMemory(), {"r1": specs["own"], "r2": specs["other"]})
        settled = each.settle(test, Ended(result=played(test)), interrupted=False)
        assert isinstance(settled.outcome, Measured)
        return float(settled.outcome.response.variance[0])

    mocap, onboard = spec("motion-capture", 0.002), spec("onboard")
    (omega_rad_s,) = TEST.omega_rad_s
    alone = variance(own=mocap, other=mocap)
    more = variance(own=mocap, other=onboard) - alone
    assert more == pytest.approx((0.002 * omega_rad_s) ** 2, rel=1e-6)
    assert variance(own=onboard, other=mocap) == alone


@pytest.mark.parametrize(
    ("rang_s", "codes"), [(1.0, ["nonlinear"]), (9.0, ["ringing", "nonlinear"])]
)
def test_a_robot_that_rings_for_as_long_as_it_says_is_not_warned_of(
    rang_s: float, codes: list[str]
) -> None:
    spec = puppet_spec().model_copy(update={"settling_time_s": 4.0})
    ringing = Finding(code="ringing", text="it rings", value=rang_s)
    bent = Finding(code="nonlinear", text="it is bent", value=0.02)
    one = np.ones(1)
    response = FrequencyResponse(one, one + 0j, one, 3, Quality(warnings=(ringing, bent)))
    left = without_the_expected(response, spec).quality.warnings
    assert [finding.code for finding in left] == codes
