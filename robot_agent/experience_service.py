"""Answers requests for the experiences of one robot: its offers, and their files."""

from __future__ import annotations

import logging
from collections.abc import Callable
from functools import partial

from nufleet.robot_agent.flight.inverse_model import NetworkInverse
from nufleet.robot_agent.flight.memory import Kept, Memory, MemoryFolderError
from nufleet.robot_agent.flight.prior_bounds import out_of_bounds
from nufleet.robot_agent.network.trust import ROUTER_SILENT, Trust
from nufleet.robot_agent.robot import Robot
from nufleet.robot_agent.rules.ownership import Commander
from nufleet.shared.errors import InvalidInputError, RefusedError
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.file import decode_experience, digest
from nufleet.shared.experience.manifest import ExperienceManifest, misfit
from nufleet.shared.wire.codec import Message
from nufleet.shared.wire.messages import (
    Done,
    ExperienceFile,
    ExperienceOffer,
    FetchRequest,
    InstallRequest,
    Refusal,
    RemovePriorRequest,
)

_log = logging.getLogger(__name__)


class ExperienceService:
    """Installs and serves the experiences of one robot; called from the endpoint's thread."""

    def __init__(
        self,
        name: str,
        robot: Robot,
        memory: Memory,
        change: Callable[[Commander], Refusal | None],
        trust: Trust,
        output_max: float | None = None,
    ) -> None:
        """Prepare to serve a robot's memory.

        Args:
            name: Name of the robot.
            robot: The robot, for its description and the names of its states.
            memory: Learned models of the robot.
            change: Function that returns why a sender may not change the robot's learned models
                now; None when it may.
            trust: Decides whose experiences the robot takes, and signs its own.
            output_max: Largest |γ| in unit/s that a prior may output; None for a bound that follows
                from the robot's own.

        Raises:
            MemoryFolderError: An own experience that is signed now cannot be stored.
            InvalidInputError: The robot's key cannot be read.
        """
        self._name, self._robot, self._memory, self._change = name, robot, memory, change
        self._trust, self._output_max = trust, output_max
        self._sign_own()
        self._review_priors()

    def offers(self) -> tuple[ExperienceOffer, ...]:
        """Return an offer of each experience learned on this robot.

        If the identity was renewed since, those of a former authority are signed again before.
        """
        if self._trust.identity() != self._signed_as:
            try:
                self._sign_own()
            except (InvalidInputError, MemoryFolderError) as error:
                _log.warning("%s: its experiences keep their signatures: %s", self._name, error)
        return tuple(offer_of(kept) for kept in self._memory.experiences)

    def priors(self) -> tuple[ExperienceOffer, ...]:
        """Return the priors that the robot flies with, the first of which it takes by itself."""
        return tuple(offer_of(kept) for kept in self._memory.priors)

    def fetch(self, request: FetchRequest) -> Message:
        """Return the file of a stored experience; raises RefusedError for an unknown digest."""
        kept = self._found(request.sha256)
        return ExperienceFile(sha256=kept.sha256, payload=kept.payload)

    def install_experience(self, request: InstallRequest) -> Message:
        """Store an experience that was trained from this robot's own flights."""
        return self._installed(request, lambda payload, _: self._keep_own(payload), own=True)

    def install_prior(self, request: InstallRequest) -> Message:
        """Store another robot's experience as the prior to fly with, or as one of several."""
        return self._installed(
            request, partial(self._memory.keep_prior, beside=request.beside), own=False
        )

    def remove_prior(self, request: RemovePriorRequest) -> Message:
        """Remove all priors, so that the robot flies without one, or its model of itself."""
        refusal = self._change(Commander(request.sender, request.epoch))
        if refusal is not None:
            return refusal
        if request.what == "own-model":
            self._memory.forget_own_model()
        else:
            self._memory.forget_prior()
        return Done()

    def _installed(
        self, request: InstallRequest, keep: Callable[[bytes, str], Kept], *, own: bool
    ) -> Message:
        refusal = self._change(Commander(request.sender, request.epoch))
        if refusal is not None:
            return refusal
        experience = decode_experience(request.payload, request.sha256)
        manifest = experience.manifest
        if own and manifest.robot != self._name:
            return Refusal(
                code="misfit",
                reason=f"it was learned on {manifest.robot}; install it as a prior instead",
            )
        refusal = self._trust.refusal(request.payload)
        if refusal is not None:
            return refusal
        for axis in manifest.axes:
            reason = misfit(manifest, self._robot.spec, self._robot.state_names, axis)
            if reason is not None:
                return Refusal(code="misfit", reason=f"the experience does not fit: {reason}")
        if request.beside and not own:
            try:
                CombinedLayout([*(p.manifest.layout for p in self._memory.priors), manifest.layout])
            except InvalidInputError as error:
                return Refusal(
                    code="misfit",
                    reason=f"the experience of {manifest.robot} cannot fly beside the priors that "
                    f"it holds: {error}",
                )
        refusal = None if own else self._out_of_bounds(manifest, NetworkInverse(experience))
        return refusal or offer_of(keep(request.payload, request.sha256))

    def _sign_own(self) -> None:
        """Sign what was learned without this identity, or under a former authority."""
        self._signed_as = self._trust.identity()
        for kept in self._memory.experiences:
            signed = self._trust.signed(kept.payload)
            if signed != kept.payload:
                self._memory.keep_experience(signed, digest(signed))

    def _review_priors(self) -> None:
        """Remove priors that are no longer taken."""
        for kept in self._memory.priors:
            refusal = self._trust.refusal(kept.payload)
            refusal = refusal or self._out_of_bounds(kept.manifest, kept.inverse)
            if refusal is not None and refusal.code != ROUTER_SILENT:
                _log.warning("%s: its priors are removed: %s", self._name, refusal.reason)
                self._memory.forget_prior()
                break

    def _out_of_bounds(
        self, manifest: ExperienceManifest, inverse: NetworkInverse
    ) -> Refusal | None:
        reason = out_of_bounds(inverse, manifest.layout, self._robot.spec, most=self._output_max)
        if reason is None:
            return None
        return Refusal(code="bounds", reason=f"the experience of {manifest.robot}: {reason}")

    def _keep_own(self, payload: bytes) -> Kept:
        signed = self._trust.signed(payload)
        return self._memory.keep_experience(signed, digest(signed))

    def _found(self, sha256: str) -> Kept:
        kept = self._memory.find(sha256)
        if kept is None:
            raise RefusedError(
                "unknown-experience", f"it has no experience with sha256 {sha256}", self._name
            )
        return kept


def offer_of(kept: Kept) -> ExperienceOffer:
    """Return the offer of a stored experience: its digest, size and manifest."""
    return ExperienceOffer(sha256=kept.sha256, size_bytes=len(kept.payload), manifest=kept.manifest)
