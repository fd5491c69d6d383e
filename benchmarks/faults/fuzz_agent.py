"""Malformed requests to a live agent over a real session: one reply to each, and it lives on."""

from __future__ import annotations

import time
from collections.abc import Iterator

import numpy as np

from benchmarks.faults.fuzz_targets import example_messages
from benchmarks.faults.fuzzing import EscapedError, Mutator, Tally
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.errors import MalformedMessageError, RefusedError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.codec import Message, decode, encode
from nufleet.shared.wire.frame import CHECKSUM, sealed
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import (
    AcknowledgeRequest,
    CancelRequest,
    DescribeRequest,
    FetchRequest,
    ForecastRequest,
    GoalRequest,
    GoalResult,
    InstallRequest,
    Outcome,
    Refusal,
    ReleaseRequest,
    RemovePriorRequest,
    ResultRequest,
    StopRequest,
)
from nufleet.shared.wire.session import Session

LEAVES: dict[str, type[Message]] = {
    "describe": DescribeRequest,
    "goal": GoalRequest,
    "cancel": CancelRequest,
    "result": ResultRequest,
    "acknowledge": AcknowledgeRequest,
    "release": ReleaseRequest,
    "stop": StopRequest,
    "experience": FetchRequest,
    "experience/install": InstallRequest,
    "prior": FetchRequest,
    "prior/install": InstallRequest,
    "prior/remove": RemovePriorRequest,
    "forecast": ForecastRequest,
}
"""What an agent serves, and what each takes."""

OVERSIZED_BYTES = (65 * 2**10, 9 * 2**20)
OVERSIZED_EVERY = 400
ANSWER_TIMEOUT_S = 30.0
SENDER = "me"
"""Sender of the example messages, so that the requests are refused for what was altered."""


def fuzz_agent(
    session: Session, keys: FleetKeys, robot: str, count: int, rng: np.random.Generator
) -> list[Tally]:
    """Ask malformed questions on every key of a robot, and put malformed stops.

    Raises:
        EscapedError: a question got no reply, several, or one that is none.
    """
    tallies = {leaf: Tally(f"live: {leaf}") for leaf in LEAVES}
    stops = Tally("live: puts to the stop keys")
    for leaf, payload in _questions(count, rng):
        if leaf == "stop" and stops.payloads <= tallies[leaf].payloads:  # a put and a query in turn
            everyone = stops.payloads % 2 == 1
            key = keys.stop(SENDER) if everyone else keys.command(robot, SENDER, "stop")
            session.put_urgent(key, payload)
            stops.payloads += 1
            continue
        tally = tallies[leaf]
        began_s = time.perf_counter()
        key = keys.request(robot, SENDER, leaf)
        replies: list[bytes] = []
        # On a starved machine, a link is lost and mended now and then, and the question with it.
        while not replies and time.perf_counter() < began_s + ANSWER_TIMEOUT_S:
            replies = session.ask_all(key, payload, timeout_s=ANSWER_TIMEOUT_S)
        tally.slowest_s = max(tally.slowest_s, time.perf_counter() - began_s)
        tally.payloads += 1
        if len(replies) != 1:
            raise EscapedError(f"{leaf}: {len(replies)} replies to {payload[:200]!r}")
        refusal = _refusal(replies[0])
        if refusal is None:
            tally.accepted += 1
        elif refusal.code == "internal-error":
            raise EscapedError(f"{leaf}: {refusal.reason} to {payload[:200]!r}")
        else:
            tally.refusals[refusal.code] += 1
    return [*tallies.values(), stops]


def assert_serves(fleet: Fleet, robot: str) -> None:
    """After a release the robot flies a test, once; raises EscapedError when it does not."""
    deadline_s = time.monotonic() + ANSWER_TIMEOUT_S
    watch = fleet.watch(robot)
    while True:
        try:
            # A goal that was valid by chance may still run.
            if watch.state is not None and watch.state.goal_id is not None:
                fleet.cancel(robot, watch.state.goal_id)
            fleet.release(robot)
            break
        except RefusedError as error:
            if time.monotonic() > deadline_s:
                raise EscapedError(f"it cannot be released: {error}") from error
            watch.wait_until(lambda w: False, timeout_s=0.05)
    goal_id = f"after-{time.monotonic_ns()}"
    motion = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)
    fleet.submit(robot, GoalRequest(goal_id=goal_id, owner=fleet.orchestrator_id, motion=motion))
    ended = watch.wait_until(
        lambda w: w.state is not None and w.state.last_goal_id == goal_id,
        timeout_s=ANSWER_TIMEOUT_S,
    )
    if not ended or fleet.result(robot, goal_id).outcome is not Outcome.COMPLETED:
        raise EscapedError("it does not fly any more")


def _questions(count: int, rng: np.random.Generator) -> Iterator[tuple[str, bytes]]:
    examples = example_messages()
    by_leaf = {
        leaf: Mutator(rng, [_unsealed(m) for m in examples if isinstance(m, kind)])
        for leaf, kind in LEAVES.items()
    }
    anything = Mutator(rng, [_unsealed(m) for m in examples])
    leaves = list(LEAVES)
    for number in range(count):
        leaf = leaves[number % len(leaves)]
        if number % OVERSIZED_EVERY == 0:
            yield leaf, bytes(OVERSIZED_BYTES[rng.integers(len(OVERSIZED_BYTES))])
        elif rng.random() < 0.2:
            yield leaf, sealed(anything.payload())
        else:
            yield leaf, sealed(by_leaf[leaf].payload())


def _unsealed(message: Message) -> bytes:
    return encode(message)[: -CHECKSUM.size]


def _refusal(reply: bytes) -> Refusal | None:
    """Return the refusal in a reply; None for any other answer that there is."""
    kinds = {type(message) for message in example_messages()} - {GoalResult}
    try:
        answer = decode(reply, GoalResult, *kinds)
    except MalformedMessageError as error:
        raise EscapedError(f"a reply that is none: {error}") from error
    return answer if isinstance(answer, Refusal) else None
