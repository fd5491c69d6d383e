"""The commands for scripts and notebooks: the same jobs with typed results, and nothing printed.

Every function takes the options of the command of the same name. What they mean is documented
there (`nufleet rank --help`); the fields of the results are documented where they are declared.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from rich.console import Console

from nufleet.orchestrator.history.catalogue import Run, read_run
from nufleet.orchestrator.runs.folder import find_run
from nufleet.shared.robots.fleet_file import find_fleet_file
from nufleet.shared.wire.identity import IDENTITY_VARIABLE
from nufleet.shared.wire.openness import LOCAL_ENDPOINT, chosen_address, open_is_accepted

if TYPE_CHECKING:
    from nufleet.orchestrator.evaluation.flight_documents import TrackResult
    from nufleet.orchestrator.jobs.track import InverseChoice
    from nufleet.orchestrator.jobs.transfer import TransferResult
    from nufleet.orchestrator.runs.rank_result import RankResult
    from nufleet.shared.experience.layout import Architecture


def rank(
    fleet: str | Path | None = None,
    *,
    connect: str | None = None,
    fleet_name: str | None = None,
    target: str | None = None,
    sources: Sequence[str] | None = None,
    band_rad_s: tuple[float, float] | None = None,
    axis: str | None = None,
    axes: Sequence[str] | None = None,
    iterations: int = 7,
    precision: float | None = None,
    amplitude: float | None = None,
    seed: int = 0,
    algorithm: str = "adaptive",
    trajectory: str | None = None,
    speed_m_s: float | None = None,
    reuse_days: float | None = None,
    realtime: float | None = None,
    wait_s: float = 0.0,
    live: bool = False,
    draws: bool = True,
    rehearses: bool = True,
    runs_root: str | Path = "runs",
    repository: str | None = None,
    console: Console | None = None,
) -> RankResult:
    """Rank sources by how close their dynamics are to a target's; see `nufleet rank`.

    Robots move. When the function returns or raises, KeyboardInterrupt included, they are at rest.

    Args:
        fleet: Path of a fleet file, or name of an installed one, whose robots are started for the
            ranking and ended after it; None for the fleet that runs at `connect`.
        connect: Endpoint of the running fleet, or `identity/FILE`; None for what the command takes
            without an option. An endpoint of another machine needs NUFLEET_OPEN=1.
        fleet_name: Name of the running fleet; None when only one is running there.
        target: Name of the robot that needs experience; None for the target of the fleet file.
        sources: Names of the robots that have experience; None for all but the target.
        band_rad_s: Lower and upper end of the operating band; None for that of the fleet file, or
            the band that all robots accept.
        axis: Name of the only axis to test; None for `axes`.
        axes: Names of the axes to test together; None for all that the robots have in common, or,
            with the paper's algorithm, for the target's first.
        iterations: Limit on the number of rounds of tests.
        precision: Width of the selected source's 95 % interval to continue to; None for any.
        amplitude: Amplitude of the task in the unit of the axis; None for what each robot chooses.
        seed: Seed of the random choices.
        algorithm: `adaptive`, `paper` for the paper's Algorithm 1, or the name of one that a
            package installs; see `nufleet.studies`.
        trajectory: Path or name of the drawing to rank for; None for no particular one.
        speed_m_s: Largest speed on that drawing; None for the default.
        reuse_days: Largest age of stored responses that replace tests, in days; None to test all.
        realtime: Speed of simulated robots relative to real time; None for as fast as possible.
        wait_s: Longest time to wait for the running fleet and its robots, in s.
        live: Whether to serve the recording to viewers while the study runs.
        draws: Whether to draw a recording and plots.
        rehearses: Whether the target is asked what error it expects of each way to fly.
        runs_root: Folder in which the run leaves its own folder.
        repository: Address of the repository; None for the one in `runs_root`.
        console: Console for progress; None to print nothing.

    Returns:
        The ranking, with a verdict on the transfer from each source.

    Raises:
        NufleetError: The request was refused, or the study could not be completed; the message
            says why, and what to do.
    """
    from nufleet.orchestrator.jobs.rank import RankCommand
    from nufleet.orchestrator.jobs.rank import rank as work

    command = RankCommand(
        fleet_file=None if fleet is None else find_fleet_file(str(fleet)),
        connect=_address(connect) if fleet is None else LOCAL_ENDPOINT,
        fleet_name=fleet_name,
        target=target,
        sources=None if sources is None else tuple(sources),
        band_rad_s=band_rad_s,
        axis=axis,
        axes=None if axes is None else tuple(axes),
        iterations=iterations,
        precision=precision,
        amplitude=amplitude,
        seed=seed,
        algorithm=algorithm,
        trajectory=trajectory,
        speed_m_s=speed_m_s,
        reuse_days=reuse_days,
        realtime=realtime,
        wait_s=wait_s,
        live=live,
        draws=draws,
        rehearses=rehearses,
        yes=True,
        runs_root=Path(runs_root),
        repository=repository,
    )
    return work(command, console or Console(quiet=True)).result


def transfer(
    target: str,
    source: str | None = None,
    *,
    file: str | Path | None = None,
    architecture: Architecture | None = None,
    connect: str | None = None,
    fleet_name: str | None = None,
    rehearses: bool = True,
    runs_root: str | Path = "runs",
    repository: str | None = None,
    console: Console | None = None,
) -> TransferResult:
    """Give an experience to a target as the prior of its online learning; see `nufleet transfer`.

    Args:
        target: Name of the robot that receives the experience.
        source: Name of the source, several names separated by commas or `all` for a mixture, `best`
            for the best of the latest ranking, or `none` to remove the target's priors; None when
            `file` is given.
        file: File of an experience; None to take one from a source.
        architecture: Architecture of the experience; None for the only one there is.
        connect: Endpoint of the running fleet, or `identity/FILE`; None for what the command takes
            without an option. An endpoint of another machine needs NUFLEET_OPEN=1.
        fleet_name: Name of the running fleet; None when only one is running there.
        rehearses: Whether the target is asked what error it expects of each way to fly.
        runs_root: Folder that holds the folders of all runs, rankings among them.
        repository: Address of the repository; None for the one in `runs_root`.
        console: Console for progress; None to print nothing.

    Returns:
        The experience that the target flies with from now on.

    Raises:
        NufleetError: The transfer was refused; the message says why, and what to do.
    """
    from nufleet.orchestrator.jobs.transfer import TransferCommand
    from nufleet.orchestrator.jobs.transfer import transfer as work

    command = TransferCommand(
        connect=_address(connect),
        fleet_name=fleet_name,
        target=target,
        source=source,
        file=None if file is None else Path(file),
        architecture=architecture,
        rehearses=rehearses,
        runs_root=Path(runs_root),
        repository=repository,
    )
    return work(command, console or Console(quiet=True))


def track(
    target: str,
    drawings: str | Sequence[str],
    *,
    speed: float = 0.6,
    scale: float = 1.0,
    inverse: InverseChoice = "auto",
    horizon_s: float = 0.4,
    learn: bool = True,
    guarded: bool = True,
    rich_flight_s: float | None = None,
    live: bool = False,
    rehearses: bool = True,
    connect: str | None = None,
    fleet_name: str | None = None,
    runs_root: str | Path = "runs",
    repository: str | None = None,
    console: Console | None = None,
) -> TrackResult:
    """Have a robot track drawings; see `nufleet track`.

    The robot moves. When the function returns or raises, KeyboardInterrupt included, it is at rest.

    Args:
        target: Name of the robot that flies.
        drawings: Path or name of a drawing, or several.
        speed: Largest speed on the paths, in the unit of the robot's axes per second.
        scale: Factor on the points of the drawings.
        inverse: Inverse model in front of the robot's own controller; `own` is its model of itself,
            `auto` takes the robot's prior if the latest ranking chose its source or if it is a
            preview, a mixture if it holds others, and none if it holds none.
        horizon_s: Horizon of a model that is learned from a zero prior, in s.
        learn: Whether the online Gaussian process learns in flight.
        guarded: Whether the guard may withdraw the inverse in flight.
        rich_flight_s: Duration in s of a rich flight before the drawings, from which the robot
            learns more of itself; None for none, unless its guard knows nothing yet.
        live: Whether to serve the recording to viewers during the flights.
        rehearses: Whether the target is asked what error it expects of its flights.
        connect: Endpoint of the running fleet, or `identity/FILE`; None for what the command takes
            without an option. An endpoint of another machine needs NUFLEET_OPEN=1.
        fleet_name: Name of the running fleet; None when only one is running there.
        runs_root: Folder in which the run leaves its own folder.
        repository: Address of the repository; None for the one in `runs_root`.
        console: Console for progress; None to print nothing.

    Returns:
        The error on every drawing.

    Raises:
        NufleetError: A drawing was refused, or the robot did not finish it; the message says why.
    """
    from nufleet.orchestrator.jobs.track import TrackCommand
    from nufleet.orchestrator.jobs.track import track as work

    command = TrackCommand(
        connect=_address(connect),
        fleet_name=fleet_name,
        target=target,
        drawings=(drawings,) if isinstance(drawings, str) else tuple(drawings),
        speed=speed,
        scale=scale,
        inverse=inverse,
        horizon_s=horizon_s,
        learn=learn,
        guarded=guarded,
        rich_flight_s=rich_flight_s,
        live=live,
        rehearses=rehearses,
        yes=True,
        runs_root=Path(runs_root),
        repository=repository,
    )
    return work(command, console or Console(quiet=True))


def load_run(run: str | Path = "latest", *, runs_root: str | Path = "runs") -> Run:
    """Read what a run left in its folder.

    Args:
        run: Path of the run's folder, its name in `runs_root`, or `latest`.
        runs_root: Folder that holds the folders of all runs.

    Returns:
        The run, with the same typed result that the function returned which made it; the result of
        a run that was interrupted is None.

    Raises:
        InvalidInputError: There is no such run, or its files are damaged.
    """
    return read_run(find_run(Path(runs_root), str(run)))


def _address(connect: str | None) -> str:
    """Return the address of a running fleet as a command without other options finds it."""
    given = os.environ.get(IDENTITY_VARIABLE) if connect is None else None
    identity = None if given is None else Path(given)
    return chosen_address(connect, identity, allow_open=open_is_accepted())
