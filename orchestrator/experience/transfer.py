"""Transfers an experience of a source or of a file to a target: check, install, read back."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from nufleet.orchestrator.experience.library import ExperienceLibrary, Place
from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.errors import InvalidInputError, MalformedMessageError, system_errors_as
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.file import EXPERIENCE_BYTES_MAX, decode_experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.experience.manifest import ExperienceManifest, Needs, misfit, unmet
from nufleet.shared.wire.messages import Description
from nufleet.shared.wire.motions import MIXTURE_MAX


@dataclass(frozen=True)
class Transferred:
    """An experience that a target now holds as its prior."""

    source: str
    """Name of the robot that learned it."""
    target: str
    """Name of the robot that holds it now."""
    sha256: str
    """Hash of the experience's file."""
    manifest: ExperienceManifest
    """Description of the experience, as stored in its file."""
    place: Place
    """Place that it was taken from."""
    reason: str
    """Phrase that says why it was taken from there."""
    learned_at: datetime | None
    """Time at which its robot had learned it, in UTC; None if it is not known."""


def transfer(
    fleet: Fleet,
    library: ExperienceLibrary,
    source: str,
    target: Description,
    architecture: Architecture | None = None,
) -> Transferred:
    """Transfer an experience of a source, which need not be there if the experience is stored.

    Args:
        fleet: Client of the fleet that the target belongs to.
        library: Experiences of the fleet's robots.
        source: Name of the robot whose experience is transferred.
        target: Description of the robot that flies with it from now on.
        architecture: Architecture of the experience to take; None takes the only one there is.

    Returns:
        The experience that the target now holds.

    Raises:
        InvalidInputError: There is none or there are several, or the experience does not fit the
            target.
        DamagedRecordError: The stored experience was altered.
        MalformedMessageError: The experience was altered on its way.
        RefusedError: The target refuses the experience.
    """
    known, reason = library.find(source, architecture)
    return _installed(fleet, target, known.read(), known.place, reason, known.learned_at)


def transfer_several(
    fleet: Fleet,
    library: ExperienceLibrary,
    sources: Sequence[str],
    target: Description,
    architecture: Architecture | None = None,
) -> tuple[Transferred, ...]:
    """Transfer the experiences of several sources, for a mixture that the target flies with.

    All of them are found, read and checked before the first is sent.

    Args:
        fleet: Client of the fleet that the target belongs to.
        library: Experiences of the fleet's robots.
        sources: Names of the sources, at least one.
        target: Description of the robot that flies with them from now on.
        architecture: Architecture of the experiences; None takes the only one that a source has.

    Returns:
        The experiences that the target now holds, in the order of the sources.

    Raises:
        InvalidInputError: There is none or there are several of a source, one does not fit the
            target, or they cannot be mixed.
        DamagedRecordError: A stored experience was altered.
        MalformedMessageError: An experience was altered on its way.
        RefusedError: The target refuses an experience.
    """
    if len(sources) > MIXTURE_MAX:
        raise InvalidInputError(
            f"{len(sources)} sources, of which a robot mixes at most {MIXTURE_MAX}: name fewer"
        )
    found = [library.find(source, architecture) for source in sources]
    payloads = [known.read() for known, _ in found]
    manifests = [decode_experience(payload).manifest for payload in payloads]
    for manifest in manifests:
        check_fit(manifest, target)
    CombinedLayout([manifest.layout for manifest in manifests])
    return tuple(
        _installed(fleet, target, payload, known.place, reason, known.learned_at, beside=place > 0)
        for place, ((known, reason), payload) in enumerate(zip(found, payloads, strict=True))
    )


def read_experience(path: Path) -> bytes:
    """Return the bytes of an experience's file, as `nufleet train` leaves it in a run's folder.

    Raises:
        InvalidInputError: The file cannot be read, or is truncated, altered or of another type.
    """
    unread = system_errors_as(InvalidInputError, f"{path}: cannot be read")
    with unread, path.open("rb") as file:
        payload = file.read(EXPERIENCE_BYTES_MAX + 1)
    try:
        decode_experience(payload)
    except MalformedMessageError as error:
        raise InvalidInputError(
            f"{path}: {error}; choose a file from the experiences folder of a `nufleet train` run"
        ) from error
    return payload


def transfer_file(fleet: Fleet, payload: bytes, target: Description) -> Transferred:
    """Transfer an experience that was read from a file.

    Args:
        fleet: Client of the target's fleet.
        payload: Content of the file, from `read_experience`.
        target: Description of the robot that flies with it from now on.

    Returns:
        The experience that the target now holds.

    Raises:
        InvalidInputError: The experience does not fit the target.
        MalformedMessageError: The experience was altered on its way.
        RefusedError: The target refuses the experience.
    """
    return _installed(fleet, target, payload, "file", "it was given as a file", None)


def _installed(
    fleet: Fleet,
    target: Description,
    payload: bytes,
    place: Place,
    reason: str,
    learned_at: datetime | None,
    *,
    beside: bool = False,
) -> Transferred:
    manifest = decode_experience(payload).manifest
    check_fit(manifest, target)
    installed = install(fleet, target.robot, "prior", payload, beside=beside)
    return Transferred(
        manifest.robot, target.robot, installed.sha256, manifest, place, reason, learned_at
    )


def check_fit(manifest: ExperienceManifest, target: Description) -> None:
    """Raise InvalidInputError unless an experience fits a robot."""
    for axis in manifest.axes:
        reason = misfit(manifest, target.spec, target.state_names, axis)
        if reason is not None:
            raise InvalidInputError(
                f"the experience of {manifest.robot} does not fit {target.robot}: {reason}; choose "
                "a source of the same kind"
            )


def check_would_fit(source: Description, target: Description, architecture: Architecture) -> None:
    """Raise InvalidInputError unless an experience that a source would learn fits a target.

    It is checked up front, so that no robot spends minutes learning an experience that the target
    cannot use.
    """
    needs = Needs(
        robot_kind=source.spec.kind,
        axes=tuple(axis.name for axis in source.spec.axes),
        unit=source.spec.axes[0].unit,
        sample_time_s=source.spec.sample_time_s,
        states=source.state_names if architecture == "state" else (),
    )
    for axis in needs.axes:
        reason = unmet(needs, target.spec, target.state_names, axis)
        if reason is not None:
            raise InvalidInputError(
                f"an experience of {source.robot} would not fit {target.robot}: {reason}; leave "
                f"{source.robot} out of the sources"
            )
