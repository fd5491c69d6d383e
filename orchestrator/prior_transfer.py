"""Hands a source's experience to a target: checked, installed, read back."""

from __future__ import annotations

from dataclasses import dataclass

from orchestrator.fleet import Fleet
from orchestrator.prior_custody import install
from shared.errors import InvalidInputError
from shared.experience import decode_experience
from shared.experience_manifest import ExperienceManifest, misfit
from shared.inverse_layout import Architecture
from shared.messages import Description


@dataclass(frozen=True)
class Transferred:
    """An experience that a target flies with now."""

    source: str
    target: str
    sha256: str
    manifest: ExperienceManifest


def transfer(
    fleet: Fleet, source: str, target: str, architecture: Architecture | None = None
) -> Transferred:
    """Transfer an experience over the network.

    Args:
        fleet: both robots' fleet.
        source: whose experience.
        target: who flies with it from now on.
        architecture: which of the source's experiences; None takes the only one it offers.

    Raises:
        InvalidInputError: the source offers none or several, or it does not fit the target.
        MalformedMessageError: it was altered on its way.
        RefusedError: the target does not take it.
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
    check_fit(offer.manifest, into)
    payload = fleet.fetch(source, offer.sha256)
    manifest = decode_experience(payload, offer.sha256).manifest
    check_fit(manifest, into)
    installed = install(fleet, target, "prior", payload)
    return Transferred(source, target, installed.sha256, manifest)


def check_fit(manifest: ExperienceManifest, target: Description) -> None:
    """Raise InvalidInputError unless an experience fits a robot."""
    for axis in manifest.axes:
        reason = misfit(manifest, target.spec, target.state_names, axis)
        if reason is not None:
            raise InvalidInputError(
                f"the experience of {manifest.robot} does not fit {target.robot}: {reason}"
            )
