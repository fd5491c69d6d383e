"""Decides which experiences a robot takes, by its own fleet file and by who signed them.

In a closed fleet the robot that learned an experience signs it. Who belongs to the fleet now is the
word of its router, which reads it from the inventory: a revoked robot is no longer among them.
"""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime

from nufleet.shared.errors import InvalidInputError, TransportError
from nufleet.shared.experience.file import decode_experience, signed_content, with_signature
from nufleet.shared.experience.signature import (
    UntrustedError,
    authority_of,
    common_name_of,
    sign,
    signer_of,
)
from nufleet.shared.robots.fleet_file import RobotPolicy
from nufleet.shared.wire.identity import Identity
from nufleet.shared.wire.messages import Refusal

ROUTER_SILENT = "no-router"
"""Code of a refusal that may be another after the router has answered."""


class Trust:
    """What one robot accepts from others, and how it vouches for its own."""

    def __init__(
        self,
        name: str,
        policy: RobotPolicy,
        identity: Identity | None,
        admitted_robots: Callable[[], frozenset[str]],
    ) -> None:
        """Prepare to decide.

        Args:
            name: Name of the robot.
            policy: What its fleet file allows.
            identity: Identity of the robot; None in an open fleet, where nothing is signed.
            admitted_robots: Function that returns the common names under which the router of a
                closed fleet admits robots.
        """
        self._name, self._policy, self._identity = name, policy, identity
        self._admitted_robots = admitted_robots

    def identity(self) -> Identity | None:
        """Return the robot's identity as its file is now; None in an open fleet."""
        if self._identity is not None:
            self._identity = self._identity.now()
        return self._identity

    def signed(self, payload: bytes) -> bytes:
        """Return the file of an experience of this robot with the robot's signature.

        A valid signature of its own remains. In an open fleet the file is returned unchanged.

        Args:
            payload: Contents of the file.

        Raises:
            InvalidInputError: The robot's key cannot sign, or its certificate is not valid now.
        """
        identity = self.identity()
        if identity is None or self._is_its_own(payload, identity):
            return payload
        try:
            key = identity.key.read_bytes()
            signature = sign(signed_content(payload), key, identity.certificate, datetime.now(UTC))
        except (OSError, UntrustedError) as error:
            raise InvalidInputError(f"the key {identity.key} cannot sign: {error}") from error
        return with_signature(payload, signature)

    def refusal(self, payload: bytes) -> Refusal | None:
        """Return why the robot does not take an experience as its prior; None when it does.

        What an orchestrator trains from its own flights, it takes without a signature: it tries it
        before it signs it. Whether it may learn at all is for `priors_from` to say.

        Args:
            payload: Contents of the file of the experience.
        """
        robot = decode_experience(payload).manifest.robot
        admitted = self._policy.priors_from
        if admitted is not None and robot not in admitted:
            allowed = f"{', '.join(admitted) or 'no robot'} (`priors_from` of {self._name})"
            reason = f"its fleet file lets it take priors from {allowed}, not from {robot}"
            return Refusal(code="policy", reason=reason)
        identity = self.identity()
        if identity is None or robot == self._name:
            return None
        try:
            self._check_signed(payload, robot, identity)
        except UntrustedError as error:
            reason = f"it cannot trust the experience of {robot}: {error}"
            return Refusal(code="untrusted", reason=reason)
        except TransportError as error:
            return Refusal(code=ROUTER_SILENT, reason=str(error))
        return None

    def _check_signed(self, payload: bytes, robot: str, identity: Identity) -> None:
        """Raise UntrustedError unless a robot that the fleet admits now has signed a file."""
        signature = decode_experience(payload).signature
        if signature is None:
            raise UntrustedError(
                f"it is not signed; start the agent of {robot} with its identity, so that {robot} "
                "signs what it has learned, and transfer it from there"
            )
        signer = signer_of(signature, signed_content(payload), identity.authority)
        principal = signer.rpartition(".")[0]
        if principal != robot:
            raise UntrustedError(f"it was signed by {principal}")
        if signer not in self._admitted_robots():
            raise UntrustedError(
                f"{robot} was revoked after it had signed, or is not a robot of the inventory"
            )

    def _is_its_own(self, payload: bytes, identity: Identity) -> bool:
        """Return whether a file bears a signature of this robot under its present authority.

        After a replacement of the authority it is signed again, since others trust the former one
        no longer.
        """
        signature = decode_experience(payload).signature
        try:
            authority = authority_of(identity.certificate, identity.authority)
            return signature is not None and common_name_of(identity.certificate) == signer_of(
                signature, signed_content(payload), authority
            )
        except UntrustedError:
            return False
