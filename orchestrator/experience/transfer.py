"""Transfers an experience from a source or a file to a target: check, install, read back."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.shared.errors import InvalidInputError, MalformedMessageError
from nufleet.shared.experience.file import EXPERIENCE_BYTES_MAX, decode_experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.experience.manifest import ExperienceManifest, Needs, misfit, unmet
from nufleet.shared.wire.messages import Description


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


def transfer(
    fleet: Fleet, source: str, target: str, architecture: Architecture | None = None
) -> Transferred:
    """Transfer an experience over the network.

    Args:
        fleet: Client of the fleet that both robots belong to.
        source: Name of the robot whose experience is transferred.
        target: Name of the robot that flies with it from now on.
        architecture: Architecture of the experience to take; None takes the only one on offer.

    Returns:
        The experience that the target now holds.

    Raises:
        InvalidInputError: The source offers none or several, or the experience does not fit the
            target.
        MalformedMessageError: The experience was altered on its way.
        RefusedError: The target refuses the experience.
    """
    offers = {o.manifest.layout.architecture: o for o in fleet.describe(source).experiences}
    if architecture is None and len(offers) == 1:
        architecture = next(iter(offers))
    if architecture is None or architecture not in offers:
        there = f"it offers {' and '.join(offers)}" if offers else "it offers none"
        raise InvalidInputError(
            f"which experience of {source}? {there}; train one with "
            f"`nufleet train --robot {source}`, or name one with --architecture"
        )
    offer = offers[architecture]
    into = fleet.describe(target)
    check_fit(offer.manifest, into)  # before anything large is sent
    payload = fleet.fetch(source, offer.sha256)
    try:
        manifest = decode_experience(payload, offer.sha256).manifest
    except MalformedMessageError as error:
        raise MalformedMessageError(
            f"robot {source} did not send the experience that it offers: {error}; transfer again"
        ) from error
    return _installed(fleet, manifest, payload, into)


def read_experience(path: Path) -> bytes:
    """Return the bytes of an experience's file, as `nufleet train` leaves it in a run's folder.

    Raises:
        InvalidInputError: The file cannot be read, or is truncated, altered or of another type.
    """
    try:
        with path.open("rb") as file:
            payload = file.read(EXPERIENCE_BYTES_MAX + 1)
    except OSError as error:
        raise InvalidInputError(f"{path}: cannot be read: {error.strerror}") from error
    try:
        decode_experience(payload)
    except MalformedMessageError as error:
        raise InvalidInputError(
            f"{path}: {error}; choose a file that `nufleet train` left in its run's experiences"
        ) from error
    return payload


def transfer_file(fleet: Fleet, payload: bytes, target: str) -> Transferred:
    """Transfer an experience that was read from a file.

    Args:
        fleet: Client of the target's fleet.
        payload: Content of the file, from `read_experience`.
        target: Name of the robot that flies with it from now on.

    Returns:
        The experience that the target now holds.

    Raises:
        InvalidInputError: The experience does not fit the target.
        MalformedMessageError: The experience was altered on its way.
        RefusedError: The target refuses the experience.
    """
    manifest = decode_experience(payload).manifest
    return _installed(fleet, manifest, payload, fleet.describe(target))


def _installed(
    fleet: Fleet, manifest: ExperienceManifest, payload: bytes, target: Description
) -> Transferred:
    check_fit(manifest, target)
    installed = install(fleet, target.robot, "prior", payload)
    return Transferred(manifest.robot, target.robot, installed.sha256, manifest)


def check_fit(manifest: ExperienceManifest, target: Description) -> None:
    """Raise InvalidInputError unless an experience fits a robot."""
    for axis in manifest.axes:
        reason = misfit(manifest, target.spec, target.state_names, axis)
        if reason is not None:
            raise InvalidInputError(
                f"the experience of {manifest.robot} does not fit {target.robot}: {reason}; choose "
                "a source of its kind"
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
