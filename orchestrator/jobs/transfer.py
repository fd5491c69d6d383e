"""The work of `nufleet transfer`: find an experience, and give it to the target as its prior."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path

import click
from rich.console import Console

from nufleet.orchestrator.conduct.preflight import check_names, check_robots
from nufleet.orchestrator.conduct.reuse import age_text
from nufleet.orchestrator.experience.library import ExperienceLibrary, Place
from nufleet.orchestrator.experience.transfer import (
    Transferred,
    read_experience,
    transfer_file,
    transfer_several,
)
from nufleet.orchestrator.flights.labels import BY_AXIS, MIXTURE
from nufleet.orchestrator.flights.legs import typical_leg
from nufleet.orchestrator.history.rankings import Ranking, latest_ranking
from nufleet.orchestrator.jobs.commands import FleetCommand
from nufleet.orchestrator.jobs.foresight import say_expected
from nufleet.orchestrator.jobs.held_way import held_way
from nufleet.orchestrator.jobs.opening import Opening
from nufleet.orchestrator.jobs.terminal import stderr_console
from nufleet.orchestrator.study.source_by_axis import in_words, sources_by_axis
from nufleet.orchestrator.study.verdict import Verdict
from nufleet.shared.errors import InvalidInputError, RefusedError
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.strict import Digest, Document, Strict
from nufleet.shared.text import split_names
from nufleet.shared.wire.messages import Description


@dataclass(frozen=True, kw_only=True)
class TransferCommand(FleetCommand):
    """The options of one `nufleet transfer`, with either a source or a file."""

    target: str
    """Name of the robot that receives the experience."""
    source: str | None
    """Name of the source, several names separated by commas, `all` for every source that has an
    experience, `best` for the best of the latest ranking, or `none` to remove the priors of the
    target; None when a file is given."""
    file: Path | None
    """File of an experience; None to take one from a source."""
    architecture: Architecture | None
    """Architecture of the experience to take; None for the only one there is."""
    rehearses: bool = True
    """Whether the target is asked what error it expects of its next flight."""


class Companion(Strict):
    """An experience that was transferred beside the first, for a mixture."""

    source: str
    """Name of the robot that learned it."""
    sha256: Digest
    """Hash of the experience's file."""
    taken_from: Place
    """Place that it was taken from."""


class TransferResult(Document):
    """What `nufleet transfer --json` prints; only the target is set if its priors were removed."""

    target: str
    """Name of the robot that flies with the experience from now on."""
    source: str | None = None
    """Name of the robot that learned it."""
    sha256: Digest | None = None
    """Hash of the experience's file."""
    manifest: ExperienceManifest | None = None
    """Description of the experience, as stored in its file."""
    taken_from: Place | None = None
    """Place that it was taken from."""
    reason: str | None = None
    """Phrase that says why it was taken from there."""
    learned_at: str | None = None
    """Time at which its robot had learned it, in ISO 8601 and UTC; None if it is not known."""
    companions: tuple[Companion, ...] = ()
    """Further experiences, which the target mixes with this one, or takes on other axes."""
    axes: dict[str, str] | None = None
    """Source of each axis, by axis, where the latest ranking found another one closer there."""


def transfer_and_print(command: TransferCommand) -> None:
    """Transfer an experience, with the result as JSON on stdout if wanted."""
    result = transfer(command, stderr_console())
    if command.as_json:
        click.echo(result.document())


def transfer(command: TransferCommand, console: Console) -> TransferResult:
    """Transfer an experience, and say which one the target flies with from now on.

    The source need not be there: its experience is then taken from the repository.

    Raises:
        InvalidInputError: There is no such experience, or it does not fit the target.
        DamagedRecordError: The stored experience was altered.
        LeaseHeldError: The target belongs to another orchestrator.
        RefusedError: The target refuses the experience.
    """
    payload = None if command.file is None else read_experience(command.file)
    split_names(command.source or "none")  # wrong names are refused before a router is looked for
    with Opening(command, console) as run:
        fleet, name, there = run.reach(command.fleet())
        check_robots((command.target,), there)
        target = fleet.describe(command.target)
        library = ExperienceLibrary(fleet, run.repository.robots, name)
        sources = () if command.source == "none" else _sources(command, run, there, library)
        run.take({command.target: target}, None)  # it only learns what it flies with
        given: tuple[Transferred, ...]
        if payload is not None:
            given = (transfer_file(fleet, payload, target),)
        elif sources:
            given = _given(command, run, library, sources, target)
        else:
            fleet.remove_prior(command.target)
            run.results.print(f"{command.target} flies without a prior from now on")
            return TransferResult(target=command.target)
        for each in given:
            _print(run.results, each)
        if command.rehearses:
            _say_expected(run, command.target)
        chosen: dict[str, str] = {}
        if len(given) > 1:
            found = _ranking(command, run) if command.source == "best" else None
            chosen = {} if found is None else sources_by_axis(found.result.ranking)
            how = "take each of these on its axes" if chosen else f"mix these {len(given)}"
            run.results.print(
                f"{command.target} can {how} from now on: `nufleet track --target {command.target} "
                f"--inverse {BY_AXIS if chosen else MIXTURE}`"
            )
    return _result(given).model_copy(update={"axes": chosen or None})


def _given(
    command: TransferCommand,
    run: Opening,
    library: ExperienceLibrary,
    sources: tuple[str, ...],
    target: Description,
) -> tuple[Transferred, ...]:
    """Give the target the experiences of sources.

    Of the best source of each axis, one that has none or that the target does not admit leaves all
    axes to the selected one.
    """
    fleet = run.connection.fleet
    try:
        return transfer_several(fleet, library, sources, target, command.architecture)
    except (InvalidInputError, RefusedError) as error:
        found = _ranking(command, run) if command.source == "best" and len(sources) > 1 else None
        if found is None:
            raise
        selected = found.result.selected
        run.console.print(f"[yellow]all axes take the experience of {selected}: {error}[/]")
        return transfer_several(fleet, library, (selected,), target, command.architecture)


def _say_expected(run: Opening, robot: str) -> None:
    """Print how the robot flies with what it holds now, if it flies paths at all, and what it
    expects of that."""
    target = run.connection.fleet.describe(robot)
    if target.spec.tracking is None:
        return
    root, studies = run.storage.runs_root, run.repository.studies
    name, way = held_way(target.priors, latest_ranking(root, studies, run.connection.name, robot))
    if name == MIXTURE and len(target.priors) == 1:
        source = target.priors[0].manifest.robot
        run.results.print(
            f"no ranking chose {source} for {robot}, which mixes its experience with none in flight"
            f": `nufleet track --target {robot} --inverse prior` flies with it alone"
        )
    if target.baseline_known:
        say_expected(run, target, way, typical_leg(target), name)


def _sources(
    command: TransferCommand, run: Opening, there: tuple[str, ...], library: ExperienceLibrary
) -> tuple[str, ...]:
    """Return the names of the sources, which may be away; empty for a file."""
    if command.source is None:
        return ()
    if command.source == "best":
        return _best(command, run)
    if command.source == "all":
        return _all(command, run, there, library)
    sources = split_names(command.source)
    check_names(command.target, sources, (command.target, *sources))
    return sources


def _ranking(command: TransferCommand, run: Opening) -> Ranking | None:
    fleet = run.connection.name
    return latest_ranking(command.runs_root, run.repository.studies, fleet, command.target)


def _best(command: TransferCommand, run: Opening) -> tuple[str, ...]:
    """Return the selected source or, where axes differ beyond doubt, the closest on each."""
    found = _ranking(command, run)
    if found is None:
        raise InvalidInputError(
            f"no ranking of {command.target} of fleet {run.connection.name} in "
            f"{command.runs_root} or in {run.repository.name}: rank its sources first with "
            f"`nufleet rank --target {command.target}`, or name a source"
        )
    leader = found.result.ranking[0]
    run.results.print(
        f"best source of {command.target}: [bold]{leader.robot}[/], "
        f"ψ* = {leader.stated}, from {found.run}"
    )
    verdict = found.result.verdicts.get(leader.robot)
    if verdict is not None and verdict.verdict is not Verdict.TRANSFER:
        run.console.print(f"[yellow]the tests say: {verdict.verdict}: {verdict.reason}[/]")
    chosen = sources_by_axis(found.result.ranking)
    if not chosen:
        return (found.result.selected,)
    said = in_words(chosen, found.result.ranking)
    run.results.print(f"axes differ in their closest source: {said}")
    return tuple(dict.fromkeys(chosen.values()))


def _all(
    command: TransferCommand, run: Opening, there: tuple[str, ...], library: ExperienceLibrary
) -> tuple[str, ...]:
    """Return every source that has an experience, those of the latest ranking first."""
    found = _ranking(command, run)
    ranked = [] if found is None else [source.robot for source in found.result.ranking]
    names = [name for name in dict.fromkeys((*ranked, *sorted(there))) if name != command.target]
    usable = []
    for name in names:
        try:
            library.find(name, command.architecture)
        except InvalidInputError as error:
            run.console.print(f"[yellow]without {name}: {error}[/]")
        else:
            usable.append(name)
    if not usable:
        raise InvalidInputError(
            f"no robot of fleet {run.connection.name} besides {command.target} has an experience "
            "to transfer; train some with `nufleet train`"
        )
    return tuple(usable)


def _print(console: Console, given: Transferred) -> None:
    layout = given.manifest.layout
    console.print(
        f"[green]{given.target} flies with the experience of {given.source} from now on[/]: "
        f"{layout.architecture}, horizon {layout.horizon_s:.2f} s, sha256 {given.sha256[:12]}…"
    )
    if given.place != "file":
        place = given.source if given.place == "robot" else "the repository"
        console.print(f"taken from {place}, {_learned(given.learned_at)}: {given.reason}")


def _learned(learned_at: datetime | None) -> str:
    if learned_at is None:
        return "learned at a time that is not known here"
    return f"learned {age_text(datetime.now(UTC) - learned_at)} ago"


def _result(several: tuple[Transferred, ...]) -> TransferResult:
    given, *others = several
    return TransferResult(
        target=given.target,
        source=given.source,
        sha256=given.sha256,
        manifest=given.manifest,
        taken_from=given.place,
        reason=given.reason,
        learned_at=None
        if given.learned_at is None
        else given.learned_at.isoformat(timespec="seconds"),
        companions=tuple(
            Companion(source=each.source, sha256=each.sha256, taken_from=each.place)
            for each in others
        ),
    )
