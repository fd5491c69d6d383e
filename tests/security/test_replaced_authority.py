"""An authority is replaced while agents run: they trust the new one from their next connection."""

from __future__ import annotations

import re
from contextlib import ExitStack
from datetime import timedelta
from pathlib import Path

import pytest
from closed_lab import KEYS, ClosedLab
from learned_things import experience
from polling import PATIENCE_S, wait_until

from nufleet.orchestrator.authority.certificates import utc_now
from nufleet.robot_agent.network.certificate_watch import CertificateWatch
from nufleet.robot_agent.network.trust import Trust
from nufleet.shared.robots.fleet_file import RobotPolicy
from nufleet.shared.wire.handshake import why_refused
from nufleet.shared.wire.identity import address_of, read_identity
from nufleet.shared.wire.transport import open_client

ROBOTS = frozenset({"a.1", "b.1"})


@pytest.fixture
def lab(tmp_path: Path) -> ClosedLab:
    return ClosedLab(tmp_path, ExitStack())


def renewed(lab: ClosedLab, *names: str) -> None:
    """Put renewed identities in the place of those that running programs were started with."""
    for name in names:
        lab.authority.renew(name, lab.identity(name).parent)


def test_a_session_finds_the_router_of_the_new_authority_without_a_restart(lab: ClosedLab) -> None:
    token, desk = KEYS.robot("a", "alive"), address_of(lab.identity("desk"))
    address = address_of(lab.identity("a"))
    with ExitStack() as stack:
        with ExitStack() as lab.stack:
            lab.start_router()
            robot = stack.enter_context(open_client(address, timeout_s=PATIENCE_S))
            robot.declare_alive(token)
        lab.authority.replace()
        renewed(lab, "a", "desk")
        lab.authority.finish_replacing()
        with ExitStack() as lab.stack:
            lab.start_router()
            watcher = stack.enter_context(open_client(desk, timeout_s=PATIENCE_S))
            wait_until(lambda: watcher.alive(token, timeout_s=PATIENCE_S) == [token])


def test_a_robot_takes_what_is_signed_under_the_new_authority_without_a_restart(
    lab: ClosedLab,
) -> None:
    started = Trust("a", RobotPolicy(), read_identity(lab.identity("a")), lambda: ROBOTS)
    before = Trust("b", RobotPolicy(), read_identity(lab.identity("b")), lambda: ROBOTS)
    of_old = before.signed(experience("b"))
    lab.authority.replace()
    renewed(lab, "a", "b")
    of_new = before.signed(experience("b"))
    assert of_new != of_old
    assert started.refusal(of_old) is None
    assert started.refusal(of_new) is None
    lab.authority.finish_replacing()
    renewed(lab, "a")
    assert started.refusal(of_new) is None
    late = started.refusal(of_old)
    assert late is not None
    assert "signed under another authority" in late.reason


def test_an_agent_lives_with_an_identity_that_was_damaged_and_uses_it_once_it_is_whole(
    lab: ClosedLab, caplog: pytest.LogCaptureFixture
) -> None:
    identity = read_identity(lab.identity("a"))
    signed = Trust("b", RobotPolicy(), read_identity(lab.identity("b")), lambda: ROBOTS).signed(
        experience("b")
    )
    whole = identity.path.read_text()
    trust = Trust("a", RobotPolicy(), identity, lambda: ROBOTS)
    # A file that is being copied, and one that was damaged on the way.
    for text in ("half a fi", re.sub(r"\n[A-Za-z0-9+/]{20}", "\n" + 20 * "A", whole)):
        watch = CertificateWatch(identity, lambda: utc_now() + timedelta(days=80))
        identity.path.write_text(text)
        caplog.clear()
        watch.look()
        assert watch.due in caplog.text
        assert watch.refusal(3600.0) is None
        assert str(identity.path) in caplog.text
        assert why_refused(identity.now()) is not None
    refusal = trust.refusal(signed)
    assert refusal is not None
    assert "its own identity names no valid authority" in refusal.reason.replace(
        "the robot's", "its"
    )
    identity.path.write_text(whole)
    assert trust.refusal(signed) is None
