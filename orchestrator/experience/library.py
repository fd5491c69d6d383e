"""The experiences of a fleet's robots: those that they offer, and those in the repository."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import TYPE_CHECKING, Literal

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.repository.records import ExperienceRecord, RobotRecord
from nufleet.shared.errors import InvalidInputError, MalformedMessageError, NoReplyError
from nufleet.shared.experience.file import decode_experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description

if TYPE_CHECKING:
    from nufleet.orchestrator.experience.train import Trained
    from nufleet.orchestrator.repository.robot_store import RobotStore

Place = Literal["robot", "repository", "file"]
"""Place that an experience is taken from."""


@dataclass(frozen=True)
class KnownExperience:
    """An experience of a robot, at the robot or in the repository."""

    sha256: str
    """Hash of its file, in hexadecimal."""
    architecture: Architecture
    """Architecture of the inverse model."""
    place: Place
    """Place that it can be taken from."""
    learned_at: datetime | None
    """Time at which its robot had learned it, in UTC; None if the repository does not know it."""
    read: Callable[[], bytes]
    """Reads and checks its file."""


class ExperienceLibrary:
    """Finds the experiences of a fleet's robots, which need not be there if these are stored."""

    def __init__(
        self,
        fleet: Fleet,
        store: RobotStore | None = None,
        name: str = "",
        known: Mapping[str, Description] | None = None,
    ) -> None:
        """Prepare to search.

        Args:
            fleet: Client of the fleet, already connected.
            store: Store of the repository; None for a fleet that exists for one run only, whose
                robots share nothing but their names with those of other runs.
            name: Name of the fleet in that store.
            known: Descriptions of robots that learn nothing meanwhile, so that these are not asked
                for what they offer.
        """
        self._fleet, self._store, self._name = fleet, store, name
        self._known = known or {}

    def keeping(self, robots: Iterable[Description], run: str) -> Callable[[Trained], None]:
        """Return a function that stores an experience which one of the robots has learned.

        Args:
            robots: Descriptions of the robots that learn; they are stored at once.
            run: Name of the run in which they learn.
        """
        store = self._store
        if store is None:
            return lambda trained: None
        store.describe(*(RobotRecord.of(self._name, one) for one in robots))

        def keep(trained: Trained) -> None:
            store.add_experience(ExperienceRecord(self._name, run, trained.payload))

        return keep

    def find(self, source: str, architecture: Architecture | None) -> tuple[KnownExperience, str]:
        """Find the newest experience of a robot.

        Args:
            source: Name of the robot that learned it.
            architecture: Architecture of the experience; None for the only one that the robot
                offers, or for the only one that is stored if it offers none.

        Returns:
            The experience, and a phrase that says why it is this one.

        Raises:
            InvalidInputError: There is none, or there are several.
            RobotLostError: Several agents answer as the source.
        """
        stored = self._stored(source)
        learned_at = {one.sha256: one.learned_at for one in stored}
        try:
            offers = (self._known.get(source) or self._fleet.describe(source)).experiences
        except NoReplyError:
            if not stored:
                raise InvalidInputError(self._unknown(source)) from None
            return choose(source, None, stored, architecture)
        offered = [
            KnownExperience(
                sha256=offer.sha256,
                architecture=offer.manifest.layout.architecture,
                place="robot",
                learned_at=learned_at.get(offer.sha256),
                read=partial(self._fetched, source, offer.sha256),
            )
            for offer in offers
        ]
        return choose(source, offered, stored, architecture)

    def _stored(self, source: str) -> list[KnownExperience]:
        store, name = self._store, self._name
        if store is None:
            return []
        return [
            KnownExperience(
                sha256=one.sha256,
                architecture=one.architecture,
                place="repository",
                learned_at=one.learned_at,
                read=partial(store.experience, name, one.sha256),
            )
            for one in store.experiences(name, source)
        ]

    def _fetched(self, source: str, sha256: str) -> bytes:
        payload = self._fleet.fetch(source, sha256)
        try:
            decode_experience(payload, sha256)
        except MalformedMessageError as error:
            raise MalformedMessageError(
                f"robot {source} did not send the experience that it offers: {error}; transfer "
                "again"
            ) from error
        return payload

    def _unknown(self, source: str) -> str:
        there = ", ".join(self._fleet.robots()) or "none"
        known = () if self._store is None else self._store.experiences(self._name)
        robots = ", ".join(sorted({one.robot for one in known})) or "no robot"
        return (
            f"no robot {source!r} in this fleet; there are {there}, and the repository holds "
            f"experiences of {robots}: start the agent of {source}, or name another source"
        )


def choose(
    source: str,
    offered: Sequence[KnownExperience] | None,
    stored: Sequence[KnownExperience],
    architecture: Architecture | None,
) -> tuple[KnownExperience, str]:
    """Choose the newest experience of a source, at the source or in the repository.

    An experience that the source offers and the repository does not have was learned with another
    repository, at an unknown time. It counts as the newest, because the source keeps only the one
    that it learned last.

    Args:
        source: Name of the source.
        offered: Experiences that the source offers; None if it does not answer.
        stored: Experiences of the source in the repository, those learned last first.
        architecture: Architecture to choose; None for the only one that is offered, or for the only
            one that is stored if none is offered.

    Returns:
        The chosen experience, and a phrase that says why.

    Raises:
        InvalidInputError: There is none, or there are several.
    """
    at_source = {one.architecture: one for one in offered or ()}
    kept = {one.architecture: one for one in reversed(stored)}
    wanted = architecture or _only(at_source or kept)
    own = None if wanted is None else at_source.get(wanted)
    newest = None if wanted is None else kept.get(wanted)
    if newest is None:
        if own is None:
            raise InvalidInputError(_unclear(source, offered, at_source, kept))
        return own, f"{source} offers it"
    if own is None:
        why = "does not answer" if offered is None else f"does not offer {wanted} now"
        return newest, f"{source} {why}"
    if own.sha256 == newest.sha256:
        return own, f"{source} offers it"
    if own.learned_at is None:
        return own, (
            f"{source} offers one that the repository does not have, which holds "
            f"{newest.sha256[:12]}… of {_day(newest.learned_at)}"
        )
    return newest, (f"{source} offers the older {own.sha256[:12]}… of {_day(own.learned_at)}")


def _unclear(
    source: str,
    offered: Sequence[KnownExperience] | None,
    at_source: Iterable[Architecture],
    kept: Iterable[Architecture],
) -> str:
    answer = "does not answer" if offered is None else f"offers {_names(at_source)}"
    stored = f", and the repository holds {_names(kept)}" if kept else ""
    return (
        f"which experience of {source}? it {answer}{stored}; train one with "
        f"`nufleet train --robot {source}`, or name one with --architecture"
    )


def _only(known: Mapping[Architecture, object]) -> Architecture | None:
    return next(iter(known)) if len(known) == 1 else None


def _names(known: Iterable[Architecture]) -> str:
    return " and ".join(known) or "none"


def _day(when: datetime | None) -> str:
    return "an unknown day" if when is None else f"{when:%Y-%m-%d %H:%M} UTC"
