"""A fleet of processes in which everything fails at random, and what holds of it all the same.

Agents are killed and frozen, links held and cut, the router and orchestrators killed, an owner
frozen until another has replaced it, robots stopped, sensors bad, while one study follows another
and each hands on an experience. The seed decides what fails when; how far the processes have come
by then is up to the machine.
"""

from __future__ import annotations

import heapq
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack
from itertools import count
from pathlib import Path

import numpy as np
import psutil

from benchmarks.faults import link
from benchmarks.faults.chaos_history import HALT_MAX_S, History, Stop
from benchmarks.faults.figure import Figure
from benchmarks.faults.fuzz_targets import experience
from benchmarks.faults.lab import Lab, double_integrator, opened_lab
from benchmarks.faults.program import Program
from benchmarks.faults.study_process import TERM_S
from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.jobs.stop import stop_robots
from nufleet.orchestrator.repository.records import StudyStatus
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.shared.errors import NufleetError
from nufleet.shared.experience.file import encode_experience

ITERATIONS = 3
REALTIME = 20.0
AT_ONCE = 3
"""Largest number of simultaneous faults."""

HEALED_MAX_S = 600.0
"""After the last fault the study in progress has to end within this time."""

Act = Callable[[], None]


class Chaos:
    """One run: `live` causes faults for a while, `heal` ends them, `history` records them."""

    def __init__(self, lab: Lab, stack: ExitStack, robots: int, rng: np.random.Generator) -> None:
        """Start a fleet, and run one study of it in peace."""
        self._lab, self._rng = lab, rng
        self._names = tuple(f"r{k}" for k in range(robots))
        lab.describe(
            {
                name: _bad_sensor(alpha) if k == robots - 1 else double_integrator(alpha)
                for k, (name, alpha) in enumerate(zip(self._names, _alphas(robots), strict=True))
            }
        )
        self._router = lab.router()
        self._links = {
            name: stack.enter_context(link.opened(lab.socket))
            for name in (*self._names, "orchestrator")
        }
        self._agents = {
            name: lab.agent(name, connect=self._links[name].endpoint, realtime=REALTIME)
            for name in self._names
        }
        self._fleet = lab.orchestrator(*self._names, name="watcher")
        for name in self._names:
            install(self._fleet, name, "experience", encode_experience(experience(name)))
        self._numbers = count(1)
        self._due: list[tuple[float, int, Act]] = []
        self._afflicted: set[str] = set()
        self._zombies: list[Program] = []
        self._study: Program | None = None
        self._study_id = "undisturbed"
        self._programs: list[Program] = [self._router, *self._agents.values()]
        self._stops: list[Stop] = []
        self.faults: Counter[str] = Counter()
        self._finish()

    def live(self, seconds: float, faults_min: int) -> None:
        """Cause at least `faults_min` faults at random for `seconds`, one study after another."""
        kinds: list[tuple[str, Callable[[], None], float]] = [
            ("agents killed", self._kill_agent, 3.0),
            ("agents frozen", self._freeze_agent, 2.0),
            ("links cut", self._cut_link, 2.0),
            ("links held", self._hold_link, 2.0),
            ("routers killed", self._kill_router, 1.0),
            ("orchestrators killed", self._kill_orchestrator, 2.0),
            ("orchestrators frozen and replaced", self._freeze_orchestrator, 0.7),
            ("robots stopped", self._stop_robot, 0.5),
        ]
        weights = np.array([weight for *_, weight in kinds])
        ends_s = time.monotonic() + seconds
        next_s = time.monotonic()
        while time.monotonic() < ends_s or self.faults.total() < faults_min:
            self._attend()
            if time.monotonic() >= next_s:
                next_s = time.monotonic() + float(self._rng.exponential(1.5))
                name, cause, _ = kinds[self._rng.choice(len(kinds), p=weights / weights.sum())]
                if len(self._afflicted) < AT_ONCE:
                    before = len(self._afflicted)
                    cause()
                    self.faults[name] += len(self._afflicted) > before
            time.sleep(0.01)

    def heal(self) -> None:
        """End all faults, let the study in progress end, and run one more."""
        while self._due:
            heapq.heappop(self._due)[2]()
        self._finish()
        self._finish()
        for zombie in self._zombies:
            zombie.wait()

    def resources(self) -> dict[str, int]:
        """Return what this process and those that live hold: threads, files and children."""
        process = psutil.Process()
        agents = [psutil.Process(agent.pid) for agent in self._agents.values()]
        return {
            "threads": threading.active_count(),
            # The links open and close one all the time.
            "files": min(process.num_fds() for _ in range(50)),
            "children": len(process.children(recursive=True)),
            "most threads of an agent": max(agent.num_threads() for agent in agents),
            "most files of an agent": max(agent.num_fds() for agent in agents),
        }

    def history(self, halt_max_s: float) -> History:
        """End all programs and return what happened."""
        for program in (*self._agents.values(), self._router):
            program.end()
        with open_repository(str(self._database)) as repository:
            studies = repository.studies.studies()
            trials = [t for s in studies for t in repository.studies.trials(s.study_id)]
        undisturbed = next(s.result for s in studies if s.study_id == "undisturbed")
        if undisturbed is None:
            raise AssertionError("the undisturbed study has no result")
        return History(
            self._lab,
            self._names[0],
            undisturbed["ranking"],
            self._programs,
            studies,
            trials,
            self._stops,
            dict(+self.faults),
            halt_max_s,
        )

    # Studies.

    @property
    def _database(self) -> Path:
        return self._lab.folder / "nufleet.sqlite"

    def _attend(self) -> None:
        """Do what is due, and make sure that an orchestrator works on a study."""
        while self._due and self._due[0][0] <= time.monotonic():
            heapq.heappop(self._due)[2]()
        if self._study is None:
            self._begin()
        elif not self._study.running:
            self._study.wait()
            self._study = None
            if self._is_over():
                self._study_id = f"study-{next(self._numbers)}"

    def _begin(self) -> None:
        self._study = self._lab.study(
            self._study_id,
            self._database,
            self._names,
            iterations=ITERATIONS,
            connect=self._links["orchestrator"].endpoint,
        )
        self._programs.append(self._study)

    def _is_over(self) -> bool:
        with open_repository(str(self._database)) as repository:
            studies = {s.study_id: s.status for s in repository.studies.studies()}
        return studies.get(self._study_id, StudyStatus.OPEN) is not StudyStatus.OPEN

    def _finish(self) -> None:
        """Have the study in progress end, with as many orchestrators as that takes."""
        ending = self._study_id
        ends_s = time.monotonic() + HEALED_MAX_S
        while self._study_id == ending:
            self._attend()
            if time.monotonic() > ends_s:
                said = "" if self._study is None else self._study.said[-3000:]
                raise AssertionError(f"{ending} did not end within {HEALED_MAX_S:g} s: {said}")
            time.sleep(0.01)

    # Faults. Each afflicts one part of the fleet until it is healed.

    def _afflict(self, who: str, lasts_s: tuple[float, float], heal: Act) -> None:
        self._afflicted.add(who)

        def healed() -> None:
            heal()
            self._afflicted.discard(who)

        due_s = time.monotonic() + float(self._rng.uniform(*lasts_s))
        heapq.heappush(self._due, (due_s, next(self._numbers) + 10**6, healed))

    def _somebody(self, *, but: str | None = None) -> str | None:
        free = [name for name in self._names if name not in self._afflicted and name != but]
        return str(self._rng.choice(free)) if free else None

    def _kill_agent(self) -> None:
        name = self._somebody()
        if name is not None:
            self._agents[name].kill()
            self._afflict(name, (0.0, 1.5), self._agents[name].start)

    def _freeze_agent(self) -> None:
        name = self._somebody()
        if name is not None:
            self._agents[name].freeze()
            self._afflict(name, (0.1, 4.0), self._agents[name].thaw)

    def _linked(self) -> str | None:
        if "orchestrator" not in self._afflicted and self._rng.random() < 0.2:
            return "orchestrator"
        return self._somebody()

    def _cut_link(self) -> None:
        name = self._linked()
        if name is not None:
            self._links[name].cut(refuse=True)
            self._afflict(name, (0.0, 4.0), self._links[name].let_through)

    def _hold_link(self) -> None:
        name = self._linked()
        if name is None:
            return
        held = self._links[name]
        directions: list[tuple[link.Direction, ...]] = [("up",), ("down",), ("up", "down")]
        held.hold(*directions[self._rng.integers(3)])
        lost = self._rng.random() < 0.5

        def heal() -> None:
            if lost:
                held.cut()
            held.let_through()

        self._afflict(name, (0.1, 4.0), heal)

    def _kill_router(self) -> None:
        if "router" not in self._afflicted:
            self._router.kill()
            self._afflict("router", (0.0, 1.0), self._router.start)

    def _kill_orchestrator(self) -> None:
        if "orchestrator" not in self._afflicted and self._study is not None:
            self._study.kill()
            self._study = None
            # The next orchestrator may begin at once.
            self._afflict("orchestrator", (0.0, 0.1), lambda: None)

    def _freeze_orchestrator(self) -> None:
        """Freeze an owner for longer than its lease; another takes over before it wakes."""
        if "orchestrator" in self._afflicted or self._study is None or not self._study.running:
            return
        zombie, self._study = self._study, None
        zombie.freeze()
        self._zombies.append(zombie)
        self._afflict("orchestrator", (TERM_S + 1.0, TERM_S + 6.0), zombie.thaw)

    def _stop_robot(self) -> None:
        name = self._somebody(but=self._names[0])
        if name is None or stop_robots(self._fleet, (name,), "chaos"):
            return
        confirmed_s = time.monotonic()

        def release() -> None:
            released_s = time.monotonic()
            try:
                self._fleet.release(name)
            except NufleetError:
                # Cut off just now, or still coming to rest: once more, a little later.
                self._afflict(name, (0.2, 0.5), release)
                return
            self._stops.append(Stop(name, confirmed_s, released_s, time.monotonic()))

        self._afflict(name, (0.3, 2.0), release)


def run(
    robots: int,
    seconds: float,
    seed: int,
    *,
    faults_min: int = 0,
    halt_max_s: float = HALT_MAX_S,
) -> tuple[History, dict[str, int], dict[str, int]]:
    """Run studies under random faults.

    Args:
        robots: Number of robots in the fleet.
        seconds: Time during which faults are caused.
        seed: Seed of the kinds and times of the faults.
        faults_min: Number of faults below which faults are caused for longer.
        halt_max_s: Longest time that a motion may continue after a stop.

    Returns:
        The history, and the resources of the process before and after it.
    """
    with ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory(prefix="nufleet-chaos-"))
        lab = stack.enter_context(opened_lab(Path(folder)))
        chaos = Chaos(lab, stack, robots, np.random.default_rng(seed))
        before = chaos.resources()
        chaos.live(seconds, faults_min)
        chaos.heal()
        after = chaos.resources()
        history = chaos.history(halt_max_s)
        found = history.violations()
        if found:
            raise AssertionError(f"{len(found)} violations with seed {seed}:\n" + "\n".join(found))
        return history, before, after


def figures(robots: int, minutes: float, seed: int) -> list[Figure]:
    """Live through a chaos and count."""
    history, before, after = run(robots, 60 * minutes, seed)
    more = {what: after[what] - before[what] for what in before}
    details = {
        "faults": sum(history.faults.values()),
        **history.faults,
        "studies": len(history.studies),
        "attempts": len(history.trials),
        "seed": seed,
    }
    return [
        Figure(f"invariants broken in {minutes:g} minutes of chaos", 0.0, "", 0.0, details),
        Figure(
            "rankings other than the undisturbed one",
            0.0,
            "",
            0.0,
            {
                "of studies that lost no robot": len(history.whole),
                "and that lost one": len(history.complete) - len(history.whole),
                "without their target": len(history.studies) - len(history.complete),
            },
        ),
        Figure(
            "threads, processes and files left behind", float(max(more.values())), "", 4.0, more
        ),
    ]


def _alphas(robots: int) -> list[float]:
    return [0.85 + 0.04 * k for k in range(robots)]


def _bad_sensor(alpha: float) -> dict[str, object]:
    faults = (
        {"kind": "not-a-number", "motion": 2, "from_sample": 40, "samples": 1},
        {"kind": "drop-out", "motion": 4, "from_sample": 90, "samples": 1},
    )
    return {"driver": "faulty", "settings": {**double_integrator(alpha), "faults": faults}}
