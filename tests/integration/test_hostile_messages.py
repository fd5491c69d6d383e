"""What no honest peer sends: every robot refuses it in words, stays at rest and lives on."""

from __future__ import annotations

import itertools
import json
import struct
import tracemalloc

import pytest
from fleet_lab import KEYS, Lab, Orchestrator, released
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.robot_agent.network.endpoint import MAX_REQUEST_BYTES
from nufleet.shared.errors import RefusedError
from nufleet.shared.wire import frame
from nufleet.shared.wire.codec import Message, decode, encode
from nufleet.shared.wire.messages import (
    AcknowledgeRequest,
    CancelRequest,
    DescribeRequest,
    Description,
    Done,
    Outcome,
    Refusal,
    ReleaseRequest,
    ResultRequest,
    RobotState,
    RobotStatus,
    StopRequest,
)
from nufleet.shared.wire.session import Session

SERVED = ("describe", "goal", "cancel", "result", "acknowledge", "release", "stop")
NOT_SERVED = ("state", "alive", "telemetry/motion", "result/g", "Goal", "goal/x", "x" * 3000)
ANY_REPLY: tuple[type[Message], ...] = (Refusal, Done, Description)
VALID: dict[str, Message] = {
    "describe": DescribeRequest(),
    "cancel": CancelRequest(sender="me", goal_id="g"),
    "result": ResultRequest(goal_id="g"),
    "acknowledge": AcknowledgeRequest(sender="me", goal_ids=("g",)),
    "release": ReleaseRequest(sender="me"),
    "stop": StopRequest(sender="me", reason="smoke"),
}


def framed(header: object, body: bytes = b"{}") -> bytes:
    head = json.dumps(header).encode()
    return frame.framed(head, body)


MALFORMED = {
    "empty": b"",
    "text": b"please stop",
    "magic alone": b"NUF1",
    "lying lengths": frame.sealed(b"NUF1" + struct.pack("<II", 2**32 - 1, 2**32 - 1)),
    "no JSON": frame.framed(b"\xff\xff", b"\xff\xff"),
    "older protocol": framed({"protocol": 0, "type": "StopRequest"}),
    "unknown type": framed({"protocol": 1, "type": "SelfDestruct"}),
    "lying array": framed(
        {"protocol": 1, "type": "Done", "arrays": [{"dtype": "<f8", "shape": [2**40]}]}
    ),
    "a field of 50 kB": framed(
        {"protocol": 1, "type": "StopRequest"}, json.dumps({"x" * 50_000: 1}).encode()
    ),
    "a sender that is none": framed(
        {"protocol": 1, "type": "StopRequest"}, b'{"sender": "**", "reason": ""}'
    ),
    "too large": b"\0" * (MAX_REQUEST_BYTES + 1),
    "much too large": b"\0" * 2**21,
}


def asked(session: Session, leaf: str, payload: bytes) -> Message:
    """Ask until there is an answer; a session whose link is lost and mended loses some."""
    replies: list[bytes] = []

    def answered() -> bool:
        key = KEYS.request("a", "me", leaf)
        replies.extend(session.ask_all(key, payload, timeout_s=PATIENCE_S))
        return bool(replies)

    wait_until(answered)
    (reply,) = replies
    return decode(reply, *ANY_REPLY)


def assert_well(orchestrator: Orchestrator, robot: PuppetRobot, goal_id: str) -> None:
    """It answers, and after a release it moves: once."""
    released(orchestrator.fleet, "a")
    motions = robot.motions
    assert orchestrator.run("a", goal_id).outcome is Outcome.COMPLETED
    assert robot.motions == motions + 1


@pytest.fixture
def robot(lab: Lab) -> PuppetRobot:
    robot = PuppetRobot()
    lab.agent("a", robot)
    return robot


@pytest.fixture
def orchestrator(robot: PuppetRobot, lab: Lab) -> Orchestrator:
    return lab.orchestrator()


@pytest.mark.parametrize("kind", MALFORMED)
def test_a_malformed_request_on_any_key_gets_a_refusal_and_the_agent_lives(
    kind: str, orchestrator: Orchestrator, robot: PuppetRobot
) -> None:
    for leaf in SERVED:
        reply = asked(orchestrator.session, leaf, MALFORMED[kind])
        assert isinstance(reply, Refusal), leaf
        assert reply.code in ("malformed", "too-large")
        assert reply.reason
        assert robot.motions == 0
        if "protocol" in kind:
            assert "protocol version 0" in reply.reason
    state = orchestrator.state("a", lambda s: s.status is RobotStatus.STOPPED)
    # The sender of that to the stop key wanted the robot to stop, however badly it was said.
    assert "malformed stop" in state.reason
    assert_well(orchestrator, robot, "g")


@settings(
    max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
@given(leaf=st.sampled_from(SERVED), payload=st.binary(max_size=200), framed=st.booleans())
def test_no_bytes_get_more_than_a_refusal(
    leaf: str, payload: bytes, framed: bool, orchestrator: Orchestrator, robot: PuppetRobot
) -> None:
    payload = b"NUF1" + payload if framed else payload
    for sent, codes in (
        (payload, ("malformed", "damaged")),
        (frame.sealed(payload), ("malformed",)),
    ):
        reply = asked(orchestrator.session, leaf, sent)
        assert isinstance(reply, Refusal)
        assert reply.code in codes
    assert robot.motions == 0


def test_a_valid_message_on_another_requests_key_is_refused(
    orchestrator: Orchestrator, robot: PuppetRobot
) -> None:
    for leaf in SERVED:
        for other, message in VALID.items():
            if leaf not in (other, "stop"):
                reply = asked(orchestrator.session, leaf, encode(message))
                assert isinstance(reply, Refusal)
                assert reply.code == "malformed"
                assert "expected" in reply.reason
    assert_well(orchestrator, robot, "g")


@pytest.mark.parametrize("leaf", NOT_SERVED, ids=lambda leaf: leaf[:20])
def test_a_key_that_is_not_served_is_named_in_the_refusal(
    leaf: str, orchestrator: Orchestrator
) -> None:
    reply = asked(orchestrator.session, leaf, encode(DescribeRequest()))
    assert isinstance(reply, Refusal)
    assert reply.code == "unknown-key"
    assert leaf[:100] in reply.reason


@pytest.mark.parametrize(
    "key", ["robot/*/describe", "robot/a/*", "robot/a/**", "**", "robot/$*a/goal"]
)
def test_a_question_to_many_keys_is_refused_by_every_robot(
    key: str, orchestrator: Orchestrator, lab: Lab
) -> None:
    other = PuppetRobot()
    lab.agent("ba", other)
    orchestrator.fleet.wait_for(("ba",), timeout_s=PATIENCE_S)
    replies = orchestrator.session.ask_all(
        f"{KEYS.root}/{key}", encode(DescribeRequest()), timeout_s=PATIENCE_S
    )
    refusals = [decode(reply, Refusal).code for reply in replies]
    # The states' own histories answer to `robot/a/state/@adv/...` alone, not to these.
    assert refusals == ["wildcard"] * (1 if key.startswith("robot/a/") else 2)


def test_a_question_that_would_stop_many_robots_stops_them(
    orchestrator: Orchestrator, lab: Lab
) -> None:
    lab.agent("b", PuppetRobot())
    orchestrator.fleet.wait_for(("b",), timeout_s=PATIENCE_S)
    replies = orchestrator.session.ask_all(
        KEYS.every_robot("by/me/stop"), encode(VALID["stop"]), timeout_s=PATIENCE_S
    )
    assert [type(decode(reply, Done, Refusal)) for reply in replies] == [Done, Done]
    for name in ("a", "b"):
        orchestrator.state(name, lambda s: s.status is RobotStatus.STOPPED)


@pytest.mark.parametrize("kind", MALFORMED)
@pytest.mark.parametrize("everyone", [False, True])
def test_a_garbled_stop_stops(
    kind: str, everyone: bool, orchestrator: Orchestrator, robot: PuppetRobot
) -> None:
    key = KEYS.stop("me") if everyone else KEYS.command("a", "me", "stop")
    orchestrator.session.put_urgent(key, MALFORMED[kind])
    orchestrator.state("a", lambda s: s.status is RobotStatus.STOPPED)
    assert_well(orchestrator, robot, "g")


def test_puts_of_many_megabytes_cost_an_agent_no_memory_and_a_stop_among_them_stops(
    orchestrator: Orchestrator, robot: PuppetRobot, lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    stranger = lab.session()
    long = bytes(8 * 2**20)
    goals = itertools.count()

    def moves_again() -> bool:
        """A stop that is read after the release stops the robot again; a router may lose some."""
        released(orchestrator.fleet, "a")
        try:
            return orchestrator.run("a", f"g{next(goals)}").outcome is Outcome.COMPLETED
        except RefusedError as error:
            if error.code != "stopped":
                raise
            return False

    tracemalloc.start()
    try:
        for _ in range(6):
            stranger.put_urgent(KEYS.robot("a", "state"), long)
            stranger.put_urgent(KEYS.command("a", "me", "stop"), long)
        orchestrator.state("a", lambda s: s.status is RobotStatus.STOPPED)
        wait_until(moves_again)
        assert "a: malformed stop" in caplog.text
        assert tracemalloc.get_traced_memory()[1] < 4 * 2**20
    finally:
        tracemalloc.stop()


def test_an_orchestrator_passes_over_garbled_and_foreign_states_and_samples(
    orchestrator: Orchestrator, lab: Lab, caplog: pytest.LogCaptureFixture
) -> None:
    told: list[str] = []
    orchestrator.fleet.observe_states(lambda state: told.append(state.robot))
    orchestrator.fleet.observe_telemetry(lambda robot, _batch: told.append(robot))
    stranger = lab.session()
    state = orchestrator.state("a", lambda s: True)
    lie = RobotState.model_validate({**dict(state), "robot": "b", "sequence": 10**6})
    for payload in (*list(MALFORMED.values())[:8], encode(lie), encode(Done())):
        stranger.put_urgent(KEYS.robot("a", "state"), payload)
        stranger.put_urgent(KEYS.robot("a", "telemetry/motion"), payload)
        stranger.put_urgent(KEYS.every_robot("state"), payload)
    wait_until(lambda: "ignoring a state of b" in caplog.text)
    wait_until(lambda: "ignoring malformed telemetry" in caplog.text)
    assert orchestrator.run("a", "g").outcome is Outcome.COMPLETED
    wait_until(lambda: len(told) > 1)
    assert set(told) == {"a"}
    assert orchestrator.fleet.robots() == ("a",)
