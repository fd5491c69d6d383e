"""A model of Zenoh behind one router: sessions, liveliness tokens, and messages that may be lost.

It reproduces measurements of the real network. A dead process loses its session within
milliseconds, a frozen or cut-off one when its lease expires. A process that loses its session sees
all tokens disappear, and sees them again once it is reconnected. News of tokens arrives in order;
messages carry no guarantee at all.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Protocol

from benchmarks.faults.simulation.world import Job, World
from nufleet.robot_agent.rules.freezes import FROZEN_S

LEASE_S = 2.0
_TOLD_S = 0.003
Answer = Any
OnAnswer = Callable[[Answer], None]


class NoAnswer:
    """The answer to a question that got no reply."""


@dataclass(frozen=True)
class Weather:
    """Quality of the network."""

    lost: float = 0.0
    """Share of messages that are lost."""

    doubled: float = 0.0
    """Share of messages that arrive twice."""

    delay_s: float = 0.002
    """Mean delay of a message."""

    late: float = 0.0
    """Share of messages that are late in addition."""

    late_s: float = 0.0
    """Largest additional delay of a late message."""


class Owner(Protocol):
    """A process on the network."""

    def told(self, kind: str, name: str, alive: bool) -> None:
        """Take the news that a token of a kind (`robot` or `orchestrator`) appeared or disappeared.

        Args:
            kind: Kind of the process that the token belongs to.
            name: Name of that process.
            alive: True if the token appeared, False if it disappeared.
        """

    def asked(self, question: str, body: Any, answer: OnAnswer) -> None:
        """Take a question; `answer` sends the reply."""


@dataclass(eq=False)
class Node:
    """One process as the network sees it."""

    kind: str
    """Kind of process: `robot` or `orchestrator`."""

    name: str
    """Name under which the process is reached."""

    owner: Owner
    """The process itself."""

    running: bool = True
    """Whether the process runs."""

    frozen: bool = False
    """Whether the process is frozen."""

    cut: bool = False
    """Whether the process is cut off from the router."""

    session: bool = False
    """Whether the process has a session, and hence a token."""

    knows: set[tuple[str, str]] = field(default_factory=set)
    """Kind and name of the tokens that the process knows to be present."""

    kept: list[Job] = field(default_factory=list)
    """Jobs that wait until the process thaws."""

    frozen_since_s: float = 0.0
    """Time at which the process was last frozen."""

    thawed_s: float = -math.inf
    """Time at which the process last thawed from a freeze that is longer than a pause."""

    quiet_since: int = 0
    """Number of times the process was frozen or cut off, to tell these apart."""

    def do(self, job: Job) -> None:
        """Run a job in this process: after the thaw if it is frozen, never if it has ended."""
        if not self.running:
            return
        if self.frozen:
            self.kept.append(job)
        else:
            job()


class Network:
    """One router and the nodes that reach it."""

    def __init__(self, world: World, weather: Weather) -> None:
        self.world = world
        self.weather = weather
        self.router = True
        self.nodes: list[Node] = []

    # Sessions and tokens.

    def join(self, kind: str, name: str, owner: Owner) -> Node:
        """Start a process, which is connected within 10 ms."""
        node = Node(kind, name, owner)
        self.nodes.append(node)
        self._connect_soon(node, 0.01)
        return node

    def end(self, node: Node) -> None:
        """End a process; the others receive this news within milliseconds."""
        node.running = False
        self.nodes.remove(node)
        self._drop(node)

    def freeze(self, node: Node, for_s: float) -> None:
        """Freeze a process for `for_s` seconds; arriving messages wait until it thaws."""
        if node.frozen or not node.running:
            return
        node.frozen, node.frozen_since_s = True, self.world.now_s
        self._expire_later(node)
        self.world.after(for_s, lambda: self._thaw(node))

    def cut(self, node: Node, for_s: float) -> None:
        """Cut a process off from the router for `for_s` seconds."""
        if node.cut:
            return
        node.cut = True
        self._expire_later(node)
        self.world.after(for_s, lambda: self._heal(node))

    def restart_router(self, down_s: float) -> None:
        """End the router, and start it again after `down_s` seconds."""
        if not self.router:
            return
        self.router = False
        for node in tuple(self.nodes):
            self._drop(node)
        self.world.after(down_s, self._router_back)

    def _router_back(self) -> None:
        self.router = True
        for node in self.nodes:
            self._connect_soon(node, 1.0)

    def _expire_later(self, node: Node) -> None:
        node.quiet_since += 1
        since = node.quiet_since

        def expire() -> None:
            if node.session and node.quiet_since == since and (node.cut or node.frozen):
                self._drop(node)

        self.world.after(LEASE_S, expire)

    def _thaw(self, node: Node) -> None:
        if not node.running:
            return
        node.frozen = False
        if self.world.now_s - node.frozen_since_s > FROZEN_S:
            node.thawed_s = self.world.now_s
        kept, node.kept = node.kept, []
        for job in kept:
            node.do(job)
        self._connect_soon(node, 1.0)

    def _heal(self, node: Node) -> None:
        node.cut = False
        if node.running:
            self._connect_soon(node, 1.0)

    def _connect_soon(self, node: Node, within_s: float) -> None:
        def connect() -> None:
            fit = node.running and self.router and not node.cut and not node.frozen
            if not fit or node.session:
                return
            node.session = True
            for other in self.nodes:
                if other.session and other is not node:
                    self._tell(other, node, True)
                    self._tell(node, other, True)

        if not node.session:
            self.world.after(self.world.between(0.0, within_s), connect)

    def _drop(self, node: Node) -> None:
        """Drop a session at the router; its process notices, too, unless it cannot."""
        if not node.session:
            return
        node.session = False
        for other in self.nodes:
            if other.session:
                self._tell(other, node, False)
        self.world.after(_TOLD_S, lambda: node.do(lambda: self._forget_all(node)))
        if node.running and self.router:
            self._connect_soon(node, 1.0)

    def _forget_all(self, node: Node) -> None:
        for kind, name in sorted(node.knows):
            node.knows.discard((kind, name))
            node.owner.told(kind, name, False)

    def _tell(self, node: Node, of: Node, alive: bool) -> None:
        token = (of.kind, of.name)

        def tell() -> None:
            if alive == (token in node.knows) or (alive and not node.session):
                return
            if not alive and any(
                (other.kind, other.name) == token and other.session for other in self.nodes
            ):
                return
            (node.knows.add if alive else node.knows.discard)(token)
            node.owner.told(of.kind, of.name, alive)

        self.world.after(_TOLD_S, lambda: node.do(tell))

    # Messages.

    def reaches(self, node: Node) -> bool:
        """Return whether messages to and from a node get through now."""
        return node.session and not node.cut and self.router

    def send(self, sender: Node, receiver: Node, arrive: Job, extra_s: float = 0.0) -> None:
        """Send a message; it may be lost, late, or arrive twice."""
        draw, weather = self.world.random.random, self.weather
        copies = 2 if draw() < weather.doubled else 1
        for _ in range(copies):
            if draw() < weather.lost or not (self.reaches(sender) and self.reaches(receiver)):
                continue
            delay_s = weather.delay_s * (0.5 + draw()) + extra_s
            if draw() < weather.late:
                delay_s += weather.late_s * draw()

            def deliver() -> None:
                if self.reaches(receiver) or receiver.frozen:
                    receiver.do(arrive)

            self.world.after(delay_s, deliver)

    def ask(
        self,
        sender: Node,
        kind: str,
        name: str,
        question: str,
        body: Any,
        *,
        timeout_s: float,
        on_answer: OnAnswer,
    ) -> None:
        """Ask the process with a kind and a name.

        Args:
            sender: Process that asks.
            kind: Kind of the process asked.
            name: Name of the process asked.
            question: Name of the question.
            body: Content of the question.
            timeout_s: Time to wait for a reply.
            on_answer: Callback that receives exactly one answer, `NoAnswer` without a reply.
        """
        answered = False

        def finish(answer: Answer) -> None:
            nonlocal answered
            if not answered:
                answered = True
                on_answer(answer)

        def give_up() -> None:
            sender.do(lambda: finish(NoAnswer()))

        found = [n for n in self.nodes if (n.kind, n.name) == (kind, name) and n.session]
        if not found or not self.reaches(sender):
            self.world.after(0.01, give_up)
            return
        self.world.after(timeout_s, give_up)
        receiver = found[0]

        def reply(answer: Answer) -> None:
            self.send(receiver, sender, lambda: finish(answer))

        self.send(sender, receiver, lambda: receiver.owner.asked(question, body, reply))
