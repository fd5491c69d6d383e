"""How a simulated orchestrator leases its robots, keeps the leases, and loses them."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from benchmarks.faults.simulation.history import Violation
from benchmarks.faults.simulation.repository import SimulatedRepository
from nufleet.orchestrator.conduct import leases as robot_leases
from nufleet.orchestrator.conduct.leases import RENEW_EVERY_S
from nufleet.orchestrator.fleet.requests import QUERY_TIMEOUT_S
from nufleet.orchestrator.repository.errors import LeaseHeldError, LeaseLostError, RepositoryError
from nufleet.orchestrator.repository.records import Lease, Renewal
from nufleet.shared.errors import RobotOwnedError
from nufleet.shared.wire.messages import Description

if TYPE_CHECKING:
    from benchmarks.faults.simulation.orchestrator import SimulatedOrchestrator


class Leasing:
    """The leases of one orchestrator process.

    `leases` is empty until every robot is leased, and after they were released.
    """

    def __init__(
        self,
        process: SimulatedOrchestrator,
        repository: SimulatedRepository,
        clock: Callable[[], float],
        everyone: Sequence[SimulatedOrchestrator],
    ) -> None:
        """Prepare to lease all robots.

        Args:
            process: The process that takes the robots; told when it has them or loses them.
            repository: Repository that keeps the leases.
            clock: Function that returns the time of day in seconds, which people may set.
            everyone: All orchestrators of the simulation, this one among them.
        """
        self.leases: tuple[Lease, ...] = ()
        self.clock = clock
        self._process, self._repository, self._everyone = process, repository, everyone
        self._descriptions: dict[str, Description] = {}
        self._watched: dict[tuple[str, str, int], tuple[Renewal, float]] = {}
        self._renewed_s = self._described_s = 0.0

    @property
    def epochs(self) -> dict[str, int]:
        """Epoch of each robot's lease."""
        return {lease.robot: lease.epoch for lease in self.leases}

    def release(self) -> None:
        """Release all leases in the repository."""
        self._repository.release(self.leases)

    def describe_all(self) -> None:
        """Ask every robot to describe itself, and lease them all once the last has answered."""
        process = self._process
        self._descriptions = {}
        self._described_s = process.world.now_s

        def told(robot: str, answer: Any) -> None:
            if process.over is not None:
                return
            if not isinstance(answer, Description):
                process.end(f"{robot} does not describe itself")
                return
            self._descriptions[robot] = answer
            if len(self._descriptions) < len(process.robots):
                return
            if self.leases:
                self._confirm()
            else:
                self._lease()

        for robot in process.robots:
            process.ask(robot, "describe", None, QUERY_TIMEOUT_S, lambda a, r=robot: told(r, a))

    def _lease(self) -> None:
        process = self._process
        if process.over is not None or process.interrupted:
            return
        now_s, clock_s = process.world.now_s, self.clock()
        silent = [r for r, since_s in self._watched.values() if now_s - since_s > r.term_s]
        fleet: Any = process
        try:
            robot_leases.check_others(fleet, self._descriptions, self._repository.last(clock_s))
            self.leases = self._repository.acquire(
                process.robots,
                owner=process.name,
                above_epochs={r: found.epoch for r, found in self._descriptions.items()},
                now_s=clock_s,
                silent=silent,
            )
        except LeaseHeldError as held:
            for renewal in held.renewals:
                key = (renewal.robot, renewal.owner, renewal.epoch)
                if self._watched.setdefault(key, (renewal, now_s))[0] != renewal:
                    process.end(str(held))
                    return
            process.world.after(0.5, lambda: process.node.do(self._lease))
            return
        except (RobotOwnedError, RepositoryError) as error:
            process.end(str(error))
            return
        if self._watched:
            self.describe_all()  # another orchestrator may have come while this one waited
        else:
            self._take_over()

    def _confirm(self) -> None:
        fleet: Any = self._process
        try:
            robot_leases.check_others(
                fleet, self._descriptions, self._repository.last(self.clock())
            )
        except RobotOwnedError as error:
            self._process.end(str(error))
            return
        self._take_over()

    def _take_over(self) -> None:
        process = self._process
        now_s = process.world.now_s
        process.history.tell(now_s, f"{process.name} takes all robots, {self.leases[0].epoch}")
        # For owners from another repository, the robots' own knowledge is the only evidence.
        known = {m.owner for m in process.history.motions if m.began_s < self._described_s}
        for other in self._everyone:
            commands, other.commands = other.commands, False
            if other is process or other.name not in known:
                continue
            if commands and process.is_alive(other.name):
                raise Violation(f"{now_s:.3f}: {process.name} takes the robots of {other.name}")
        process.commands = True
        self._renewed_s = now_s
        process.world.after(RENEW_EVERY_S, lambda: process.node.do(self._renew))
        process.begin_study()

    def _renew(self) -> None:
        process = self._process
        if process.over is not None:
            return
        try:
            self._repository.renew(self.leases, self.clock())
        except LeaseLostError as error:
            process.fail(error)
            self._check_lost(error)
            return
        except RepositoryError as error:
            if process.world.now_s - self._renewed_s > self.leases[0].term_s:
                process.fail(error)
                return
        else:
            self._renewed_s = process.world.now_s
        process.world.after(RENEW_EVERY_S, lambda: process.node.do(self._renew))

    def _check_lost(self, error: LeaseLostError) -> None:
        known = self._repository.leases[error.robot]
        if known.owner == self._process.name:
            raise Violation(
                f"{self._process.world.now_s:.3f}: {self._process.name} loses its leases, and "
                f"none was taken over: {error}"
            )
