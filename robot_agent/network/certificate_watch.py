"""Watches the end of a robot's certificate, at which the router closes its link.

A goal is not accepted when it could still run at that moment: the motion would end as if its owner
had died. A renewed identity file takes effect at the next connection, so until the old certificate
has ended, the old one counts.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from datetime import datetime, timedelta

from nufleet.shared.wire.handshake import validity
from nufleet.shared.wire.identity import Identity, IdentityError
from nufleet.shared.wire.messages import Refusal

MARGIN_S = 60.0
"""Time that a certificate has to outlast a motion: the robot comes to rest in it, and the router,
which closes the link, may have a clock that is ahead."""

WARN_BELOW = 1 / 3
"""Part of a certificate's life that is left when warnings begin."""

WARN_EVERY = timedelta(days=1)

_log = logging.getLogger(__name__)


class CertificateWatch:
    """Tells whether a goal may begin; used from the endpoint's thread."""

    def __init__(self, identity: Identity, now: Callable[[], datetime]) -> None:
        """Begin with the certificate under which the robot is connected.

        Args:
            identity: Identity with which the robot's session was opened.
            now: Function that returns the present time in UTC.
        """
        self._identity, self._now = identity, now
        self._begins, self._ends = validity(identity)
        self._look_at = self._ends - WARN_BELOW * (self._ends - self._begins)

    def look(self) -> None:
        """Warn once a day while less than a third of the certificate's life is left.

        This is called regularly. An identity file that was renewed ends the warnings.
        """
        now = self._now()
        if now < self._look_at:
            return
        self._look_at = now + WARN_EVERY
        begins, ends = self._in_the_file()
        if ends - now <= WARN_BELOW * (ends - begins):
            _log.warning("%s", self.due)

    def refusal(self, duration_s: float) -> Refusal | None:
        """Return why a goal may not begin now; None when it may.

        Args:
            duration_s: Duration of its motion on the wall clock in s.
        """
        if self._now() >= self._ends:
            # The robot is still heard, so it has connected again, with the file as it is now.
            self._ends = self._in_the_file()[1]
        if (self._ends - self._now()).total_seconds() > duration_s + MARGIN_S:
            return None
        return Refusal(code="certificate", reason=self.due)

    def _in_the_file(self) -> tuple[datetime, datetime]:
        """Return from and until when the certificate in the identity's file is valid.

        If there is none, this is the one that counts now; the file may be about to be replaced.
        """
        try:
            return validity(self._identity.now())
        except IdentityError as error:
            _log.warning("%s", error)
            return self._begins, self._ends

    @property
    def due(self) -> str:
        """What has to be done about the certificate, and until when, for a person."""
        name, path = self._identity.principal, self._identity.path
        ends = f"{self._ends:%Y-%m-%d %H:%M} UTC"
        said = f"the certificate of {name} ends at {ends}, and its link with it"
        if self._in_the_file()[1] > self._ends:
            return f"{said}; {path} is renewed and takes effect then, or when the agent restarts"
        return (
            f"{said}: `nufleet fleet renew {name}` and copy the identity to {path}; the robot then "
            "connects with it by itself"
        )
