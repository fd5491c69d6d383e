"""Every principal tries every action at a real router: what is allowed works, all else does not."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from closed_lab import KEYS, ClosedLab, HonestRobot, closed_lab, settle
from polling import PATIENCE_S, wait_until

from nufleet.shared.errors import NoRouterError
from nufleet.shared.wire.keys import COMMANDS, READS
from nufleet.shared.wire.requests import Declaration
from nufleet.shared.wire.session import Session

ROLES = {
    "a": "robot",
    "b": "robot",
    "c": "robot",
    "desk": "orchestrator",
    "laptop": "orchestrator",
    "anna": "operator",
    "otto": "operator",
    "screen": "watcher",
    "thief": "revoked",
}
COUNT = itertools.count()
"""Makes each message of this module one of its kind."""


class Stage:
    """Two honest robots, an orchestrator that watches them, and a session of each principal."""

    def __init__(self, lab: ClosedLab) -> None:
        self.lab = lab
        self.robots = {name: HonestRobot(lab.session(name), name) for name in ("a", "b")}
        self.watcher = lab.session("desk")
        self.seen: list[str] = []
        for key in (KEYS.every_robot("state"), KEYS.every_robot("telemetry/*")):
            self.watcher.subscribe(key, self._saw, max_bytes=1000)
        self.actors: dict[str, Session] = {}
        self.left_behind: list[Declaration] = []

    def _saw(self, key: str, payload: bytes) -> None:
        self.seen.append(f"{key} {payload.decode()}")

    def actor(self, name: str) -> Session:
        if name not in self.actors:
            self.actors[name] = self.lab.session(name)
        return self.actors[name]

    def settle(self, actor: Session) -> None:
        settle(actor, self.watcher, *(robot.session for robot in self.robots.values()))


Observed = Callable[[], bool]


@dataclass(frozen=True)
class Action:
    """Something to try, and the names of the principals for whom it works."""

    what: str
    allowed: frozenset[str]
    attempt: Callable[[Stage, Session, str], Observed]


@pytest.fixture(scope="module")
def stage(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Stage]:
    folder: Path = tmp_path_factory.mktemp("closed")
    with closed_lab(folder) as lab:
        lab.identity("thief")
        lab.authority.revoke("thief")
        lab.start_router()
        yield Stage(lab)


def asking(key: Callable[[str], str]) -> Callable[[Stage, Session, str], Observed]:
    """Ask on a key and observe whether there is an answer."""

    def attempt(_stage: Stage, actor: Session, name: str) -> Observed:
        replies = actor.ask_all(key(name), b"?", timeout_s=PATIENCE_S)
        return lambda: bool(replies)

    return attempt


def putting(
    key: Callable[[str], str], *, to: str = "a"
) -> Callable[[Stage, Session, str], Observed]:
    """Put on a key and observe whether an honest robot hears it."""

    def attempt(stage: Stage, actor: Session, name: str) -> Observed:
        mark = f"mark-{next(COUNT)}"
        actor.put_urgent(key(name), mark.encode())
        heard = stage.robots[to].heard
        return lambda: any(line.endswith(mark) for line in heard)

    return attempt


def publishing(key: str) -> Callable[[Stage, Session, str], Observed]:
    """Put as a robot and observe whether the orchestrator sees it."""

    def attempt(stage: Stage, actor: Session, name: str) -> Observed:
        mark = f"mark-{next(COUNT)}"
        actor.put_urgent(key, mark.encode())

        def seen() -> bool:
            if any(line.endswith(mark) for line in stage.seen):
                return True
            actor.put_urgent(key, mark.encode())  # as robots repeat it; see `watching_a_state`
            return False

        return seen

    return attempt


def serving(key: str) -> Callable[[Stage, Session, str], Observed]:
    """Serve a key and observe whether two now answer a question."""

    def attempt(stage: Stage, actor: Session, name: str) -> Observed:
        declared = actor.serve(key, lambda request: request.answer(b"forged"))

        def observed() -> bool:
            return len(stage.watcher.ask_all(key, b"?", timeout_s=PATIENCE_S)) > 1

        stage.left_behind.append(declared)
        return observed

    return attempt


def token(key: Callable[[str], str]) -> Callable[[Stage, Session, str], Observed]:
    """Declare a token and observe whether the orchestrator sees it."""

    def attempt(stage: Stage, actor: Session, name: str) -> Observed:
        declared = actor.declare_alive(key(name))

        def observed() -> bool:
            return bool(stage.watcher.alive(key(name), timeout_s=PATIENCE_S))

        stage.left_behind.append(declared)
        return observed

    return attempt


def watching_a_state(stage: Stage, actor: Session, name: str) -> Observed:
    mark, got = f"mark-{next(COUNT)}", []
    actor.subscribe_state(KEYS.robot("a", "state"), lambda key, payload: got.append(payload))
    stage.robots["a"].states.put(mark.encode())

    def seen() -> bool:
        if mark.encode() in got:
            return True
        # As a robot repeats its state: the router drops one of two that reach it together.
        stage.robots["a"].states.put(mark.encode())
        return False

    return seen


def seeing_a_token(stage: Stage, actor: Session, name: str) -> Observed:
    return lambda: bool(actor.alive(KEYS.robot("a", "alive"), timeout_s=PATIENCE_S))


def seeing_the_connected(stage: Stage, actor: Session, name: str) -> Observed:
    return lambda: "a.1" in actor.connected()


def eavesdropping(stage: Stage, actor: Session, name: str) -> Observed:
    """Subscribe to the stops and commands that others give a robot."""
    mark, got = f"mark-{next(COUNT)}", []
    actor.subscribe(
        KEYS.robot("b", "by/**"), lambda key, payload: got.append(payload), max_bytes=99
    )
    settle(actor)
    stage.watcher.put_urgent(KEYS.command("b", "desk", "stop"), mark.encode())
    return lambda: mark.encode() in got


PEOPLE = frozenset({"desk", "laptop", "anna", "otto", "screen"})
COMMANDERS = frozenset({"desk", "laptop"})
STOPPERS = COMMANDERS | {"anna", "otto"}
RELEASERS = COMMANDERS | {"otto"}
NO_ONE: frozenset[str] = frozenset()

ACTIONS = [
    *(
        Action(f"ask {leaf}", PEOPLE, asking(lambda _, leaf=leaf: KEYS.robot("a", leaf)))  # type: ignore[misc]
        for leaf in READS
    ),
    *(
        Action(
            f"command {leaf}", COMMANDERS, asking(lambda n, leaf=leaf: KEYS.command("a", n, leaf))
        )  # type: ignore[misc]
        for leaf in COMMANDS
    ),
    Action("ask for a stop", STOPPERS, asking(lambda n: KEYS.command("a", n, "stop"))),
    Action("put a stop", STOPPERS, putting(lambda n: KEYS.command("b", n, "stop"), to="b")),
    Action("stop all", STOPPERS, putting(KEYS.stop)),
    Action("release", RELEASERS, asking(lambda n: KEYS.command("a", n, "release"))),
    Action(
        "command as desk", frozenset({"desk"}), asking(lambda _: KEYS.command("a", "desk", "goal"))
    ),
    Action(
        "release as desk",
        frozenset({"desk"}),
        asking(lambda _: KEYS.command("a", "desk", "release")),
    ),
    Action("stop all as anna", frozenset({"anna"}), putting(lambda _: KEYS.stop("anna"))),
    Action("stop without a name", NO_ONE, putting(lambda _: KEYS.robot("a", "stop"))),
    Action(
        "stop all without a name",
        NO_ONE,
        putting(lambda _: KEYS.robot("a", "stop").replace("robot/a/", "")),
    ),
    Action("command without a name", NO_ONE, asking(lambda _: KEYS.robot("a", "goal"))),
    Action("watch a state", PEOPLE | {"a"}, watching_a_state),
    Action("see a robot's token", PEOPLE, seeing_a_token),
    Action("hear another's commands", frozenset({"b"}), eavesdropping),
    Action(
        "be alive under its own name",
        COMMANDERS,
        token(lambda n: KEYS.orchestrator_alive(f"{n}.x")),
    ),
    Action(
        "hold the token of desk",
        frozenset({"desk"}),
        token(lambda n: KEYS.orchestrator_alive(f"desk.{n}")),
    ),
    Action("be robot c", frozenset({"c"}), token(lambda _: KEYS.robot("c", "alive"))),
    Action("be a robot that is not listed", NO_ONE, token(lambda _: KEYS.robot("ghost", "alive"))),
    Action("publish a state of b", frozenset({"b"}), publishing(KEYS.robot("b", "state"))),
    Action(
        "publish samples of b", frozenset({"b"}), publishing(KEYS.robot("b", "telemetry/motion"))
    ),
    Action("publish states of all robots", NO_ONE, publishing(KEYS.every_robot("state"))),
    Action(
        "serve b",
        frozenset({"b"}),
        serving(KEYS.robot("b", "describe")),
    ),
    Action("see who is connected", COMMANDERS, seeing_the_connected),
    Action("ask the router about others", NO_ONE, asking(lambda _: "@/*/router/**")),
    Action("ask every fleet", NO_ONE, asking(lambda _: "nufleet/*/robot/*/describe")),
    Action("ask everything", NO_ONE, asking(lambda _: "**")),
]


def test_a_robot_knows_that_an_orchestrator_listens_to_its_samples(stage: Stage) -> None:
    """It sends none where it knows of no listener, and the router withholds what others declare."""
    for robot in stage.robots.values():
        wait_until(lambda: robot.telemetry.heard)  # noqa: B023


@pytest.mark.parametrize("name", ROLES)
@pytest.mark.parametrize("action", ACTIONS, ids=lambda action: action.what.replace(" ", "-"))
def test_an_action_works_for_those_whom_the_inventory_allows(
    action: Action, name: str, stage: Stage
) -> None:
    actor = stage.actor(name)
    observed = action.attempt(stage, actor, name)
    try:
        if name in action.allowed:
            wait_until(observed)
        else:
            stage.settle(actor)
            assert not observed()
    finally:
        while stage.left_behind:
            stage.left_behind.pop().withdraw()


@pytest.mark.parametrize("name", ROLES)
def test_a_principal_learns_that_it_was_revoked(name: str, stage: Stage) -> None:
    actor = stage.actor(name)
    if name == "thief":
        with pytest.raises(
            NoRouterError, match=r"thief .*is not in the list of the router .* revoked"
        ):
            actor.check_admitted()
    else:
        actor.check_admitted()


def test_there_are_enough_cases() -> None:
    allowed = sum(len(action.allowed) for action in ACTIONS)
    assert allowed >= 60
    assert len(ACTIONS) * len(ROLES) - allowed >= 80
