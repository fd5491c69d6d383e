"""An agent in a closed fleet knows who asks, obeys nobody else, and writes it down."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path

import pytest
import zenoh
from closed_lab import KEYS, ClosedLab, closed_lab
from fleet_lab import SLOW, Orchestrator, released
from polling import PATIENCE_S, wait_until
from puppet_robot import PuppetRobot

from nufleet.orchestrator.authority.access import STATES_HZ, common_name
from nufleet.orchestrator.authority.certificates import (
    certificate_pem,
    key_pem,
    new_key,
    utc_now,
)
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.fleet.connection import running_fleet
from nufleet.orchestrator.fleet.orchestrator_id import new_orchestrator_id
from nufleet.robot_agent.agent import Agent
from nufleet.robot_agent.journal.audit_log import AUDIT_LOG, AuditEntry, read_audit_log, verified
from nufleet.robot_agent.network.certificate_watch import CertificateWatch
from nufleet.shared.errors import InvalidInputError, NoRouterError, RefusedError
from nufleet.shared.frequency_test.excitation import Tone
from nufleet.shared.private_files import write_privately
from nufleet.shared.wire.codec import decode, encode
from nufleet.shared.wire.identity import Identity, address_of, identity_text, read_identity
from nufleet.shared.wire.limits import MAX_STATE_BYTES
from nufleet.shared.wire.messages import Outcome, Refusal, RobotStatus, StopRequest
from nufleet.shared.wire.transport import _base_config, open_client


@dataclass
class Fleetlet:
    """A closed fleet with one robot, which moves."""

    lab: ClosedLab
    robot: PuppetRobot
    state_folder: Path

    def orchestrator(self, name: str) -> Orchestrator:
        session = self.lab.session(name)
        fleet = Fleet(session, KEYS, new_orchestrator_id(session.principal))
        fleet.wait_for(("a",), timeout_s=PATIENCE_S)
        return Orchestrator(session, fleet)

    def audit(self) -> list[AuditEntry]:
        return list(read_audit_log(self.state_folder / AUDIT_LOG))

    def audited(self, principal: str, asked: str, about: str) -> AuditEntry:
        """The last entry of a principal that asked for something, once it is written."""

        def found() -> list[AuditEntry]:
            searched = (principal, asked, about)
            return [e for e in self.audit() if (e.principal, e.asked, e.about) == searched]

        wait_until(lambda: bool(found()))
        return found()[-1]


@pytest.fixture(scope="module")
def fleet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Fleetlet]:
    folder = tmp_path_factory.mktemp("closed")
    with closed_lab(folder) as lab, ExitStack() as stack:
        lab.start_router()
        robot = PuppetRobot()
        agent = Agent(
            lab.session("a"), KEYS, "a", robot, realtime=None, state_folder=folder / "state"
        )
        stack.enter_context(agent)
        yield Fleetlet(lab, robot, folder / "state")


def test_a_goal_moves_the_robot_and_is_written_down(fleet: Fleetlet) -> None:
    desk = fleet.orchestrator("desk")
    assert desk.run("a", "g1").outcome is Outcome.COMPLETED
    entry = fleet.audited("desk", "goal", "g1")
    assert (entry.sender, entry.answer) == (desk.fleet.orchestrator_id, "done")
    assert verified(fleet.state_folder / AUDIT_LOG).broken is None


def test_a_goal_that_names_another_owner_is_refused_and_written_down(fleet: Fleetlet) -> None:
    desk, laptop = fleet.orchestrator("desk"), fleet.orchestrator("laptop")
    motions = fleet.robot.motions
    request = laptop.request("g2").model_copy(update={"owner": desk.fleet.orchestrator_id})
    with pytest.raises(RefusedError, match="came from laptop and names desk") as raised:
        laptop.fleet.submit("a", request)
    assert raised.value.code == "wrong-sender"
    assert fleet.robot.motions == motions
    entry = fleet.audited("laptop", "goal", "g2")
    assert entry.sender == desk.fleet.orchestrator_id
    assert entry.answer.startswith("refused wrong-sender")


def test_a_stop_and_a_release_are_attributed_and_limited(fleet: Fleetlet) -> None:
    anna, otto = fleet.orchestrator("anna"), fleet.orchestrator("otto")
    anna.fleet.stop("a", "smoke")
    state = anna.state("a", lambda state: state.status is RobotStatus.STOPPED)
    assert state.reason.startswith("stopped by anna.")
    with pytest.raises(RefusedError, match="anna may not ask 'release'"):
        anna.fleet.release("a")
    released(otto.fleet, "a")
    otto.state("a", lambda state: state.status is RobotStatus.IDLE)
    assert fleet.audited("anna", "stop", "smoke").sender == anna.fleet.orchestrator_id
    assert fleet.audited("otto", "release", "").answer == "done"


def test_a_stop_that_names_another_sender_stops_under_the_name_that_is_proven(
    fleet: Fleetlet,
) -> None:
    anna = fleet.orchestrator("anna")
    order = encode(StopRequest(sender="desk.x", reason="a lie"))
    anna.session.put_urgent(KEYS.stop("anna"), order)
    state = anna.state("a", lambda state: state.status is RobotStatus.STOPPED)
    assert state.reason == "stopped by anna.as-desk.x: a lie"
    assert fleet.audited("anna", "stop", "a lie").sender == "desk.x"
    released(fleet.orchestrator("desk").fleet, "a")


def test_a_watcher_sees_and_commands_nothing(fleet: Fleetlet) -> None:
    screen = fleet.orchestrator("screen")
    assert screen.fleet.describe("a").robot == "a"
    motions = fleet.robot.motions
    with pytest.raises(RefusedError, match="screen may not ask 'goal'"):
        screen.submit("a", "g3")
    with pytest.raises(RefusedError, match="screen may not ask 'stop'"):
        screen.fleet.stop("a", "no")
    assert fleet.robot.motions == motions
    desk = fleet.orchestrator("desk")
    assert not desk.fleet.is_alive(screen.fleet.orchestrator_id)


def test_an_identity_names_the_fleet_and_serves_no_other(fleet: Fleetlet) -> None:
    address = address_of(fleet.lab.identity("desk"))
    with running_fleet(address, None, robots=("a",), wait_s=PATIENCE_S) as connection:
        assert (connection.name, connection.robots) == ("lab", ("a",))
        assert connection.fleet.orchestrator_id.startswith("desk.")
    words = "belongs to fleet lab, not to other"
    with pytest.raises(InvalidInputError, match=words), running_fleet(address, "other"):
        pass


@pytest.mark.parametrize("mode", ["client", "peer", "router"])
def test_a_stolen_robot_can_be_no_other_robot_in_any_mode(mode: str, fleet: Fleetlet) -> None:
    thief = read_identity(fleet.lab.identity("b"))
    config = _base_config(mode)
    config.insert_json5("connect/endpoints", f'["{thief.router}"]')
    for key, value in thief.zenoh_settings().items():
        text = "true" if value is True else f'"{value}"'
        config.insert_json5(f"transport/link/tls/{key}", text)
    desk = fleet.orchestrator("desk")
    motions, before = fleet.robot.motions, fleet.audit()
    with zenoh.open(config) as session:
        own = session.liveliness().declare_token(KEYS.robot("b", "alive"))
        wait_until(lambda: desk.session.alive(KEYS.robot("b", "alive"), timeout_s=PATIENCE_S) != [])
        ghost = session.liveliness().declare_token(KEYS.orchestrator_alive("desk.x"))
        session.put(KEYS.stop("desk"), encode(StopRequest(sender="desk.x", reason="no")))
        session.put(KEYS.command("a", "b", "stop"), encode(StopRequest(sender="b", reason="no")))
        assert not list(session.get(KEYS.robot("a", "describe"), timeout=1.0))
        assert not list(session.get(KEYS.command("a", "desk", "release"), timeout=1.0))
        assert not desk.fleet.is_alive("desk.x")
        ghost.undeclare()
        own.undeclare()
    assert desk.state("a", lambda state: True).status is RobotStatus.IDLE
    assert (fleet.robot.motions, fleet.audit()) == (motions, before)


def test_a_robot_that_floods_its_state_is_heard_no_more_often_than_the_router_allows(
    fleet: Fleetlet,
) -> None:
    thief, watcher = fleet.lab.session("c"), fleet.lab.session("screen")
    heard: list[bytes] = []
    key = KEYS.robot("c", "state")
    watcher.subscribe(key, lambda _, payload: heard.append(payload), max_bytes=MAX_STATE_BYTES)
    states = thief.state_publisher(key)
    wait_until(lambda: states.put(b"first") or bool(heard))
    began_s = time.monotonic()
    for _ in range(2000):
        states.put(b"x" * 100)
    wait_until(lambda: states.put(b"last") or b"last" in heard)
    lasted_s = time.monotonic() - began_s
    assert heard.count(b"x" * 100) < 2000
    assert heard.count(b"x" * 100) <= 2 + STATES_HZ * lasted_s


def short_lived(lab: ClosedLab, folder: Path, life: timedelta) -> Identity:
    """An identity of robot b that ends soon."""
    key, path = new_key(), folder / "b.nufleet"
    made = lab.issuer.issue(common_name("b", 0), key.public_key(), utc_now(), life)
    model = read_identity(lab.identity("b"))
    write_privately(path.with_suffix(".key"), key_pem(key))
    identity = Identity(
        path,
        model.fleet,
        model.principal,
        model.role,
        model.router,
        certificate_pem(made),
        model.authority,
    )
    path.write_text(identity_text(identity))
    return identity


def test_a_renewed_certificate_takes_effect_without_a_restart(
    fleet: Fleetlet, tmp_path: Path
) -> None:
    watcher = fleet.lab.session("screen")
    token = KEYS.robot("b", "alive")
    presence: list[bool] = []
    watcher.watch_alive(token, lambda key, alive: presence.append(alive))
    with ExitStack() as stack:
        for life in (timedelta(seconds=4 * 5**n) for n in range(4)):
            ends, ending = utc_now() + life, short_lived(fleet.lab, tmp_path, life)
            with suppress(NoRouterError):
                session = open_client(address_of(ending.path), timeout_s=life.total_seconds())
                stack.enter_context(session).declare_alive(token)
                wait_until(lambda: bool(presence) or utc_now() > ends)  # noqa: B023
            if presence:
                break
            stack.close()  # a busy machine took longer than the certificate lasts
        short_lived(fleet.lab, tmp_path, timedelta(days=1))
        # The router ends the old link and takes the new certificate perhaps 2 ms later, too soon to
        # be sure of seeing each presence by itself: the whole history is what is waited for.
        wait_until(lambda: presence == [True, False, True])


@pytest.mark.parametrize(
    ("life_s", "duration_s", "refused"),
    [
        (3600, 3500, False),
        (3600, 3560, True),
        (600, 500, False),
        (65, 0, False),
        (59, 0, True),
        (-5, 0, True),
    ],
)
def test_no_goal_begins_that_may_outlast_the_certificate(
    life_s: float, duration_s: float, refused: bool, fleet: Fleetlet, tmp_path: Path
) -> None:
    began = utc_now()
    identity = short_lived(fleet.lab, tmp_path, timedelta(seconds=life_s))
    watch = CertificateWatch(identity, lambda: began)
    refusal = watch.refusal(duration_s)
    assert (refusal is not None) == refused
    if refusal is not None:
        assert refusal.code == "certificate"
        assert "`nufleet fleet renew b`" in refusal.reason
        assert isinstance(decode(encode(refusal), Refusal), Refusal)


def test_an_agent_that_runs_warns_once_a_day_when_a_third_of_the_life_is_left(
    fleet: Fleetlet, tmp_path: Path, caplog: pytest.LogCaptureFixture
) -> None:
    now = [utc_now()]
    identity = short_lived(fleet.lab, tmp_path, timedelta(days=3) - timedelta(hours=1))
    watch = CertificateWatch(identity, lambda: now[0])
    for hours, warnings in ((0, 0), (46, 0), (2, 1), (1, 1)):
        now[0] += timedelta(hours=hours)
        watch.look()
        assert [record.message for record in caplog.records] == warnings * [watch.due]
    assert "`nufleet fleet renew b`" in watch.due
    now[0] += timedelta(days=1)
    watch.look()
    assert len(caplog.records) == 2
    short_lived(fleet.lab, tmp_path, timedelta(days=90))
    assert f"{identity.path} is renewed and takes effect then" in watch.due
    now[0] += timedelta(days=1)
    watch.look()
    assert len(caplog.records) == 2


def test_a_robot_takes_the_goals_that_end_before_its_certificate_and_no_others(
    fleet: Fleetlet, tmp_path: Path
) -> None:
    ending = short_lived(fleet.lab, tmp_path, timedelta(seconds=240))
    desk, robot = fleet.orchestrator("desk"), PuppetRobot()
    with (
        open_client(address_of(ending.path), timeout_s=PATIENCE_S) as session,
        Agent(session, KEYS, "b", robot, realtime=1.0),
    ):
        desk.fleet.wait_for(("b",), timeout_s=PATIENCE_S)
        with pytest.raises(RefusedError, match="certificate of b ends at") as raised:
            desk.submit("b", "long", tones=(Tone(omega_rad_s=0.02),))
        assert raised.value.code == "certificate"
        assert robot.motions == 0
        assert desk.submit("b", "short", **SLOW).wall_duration_s < 60.0
        desk.fleet.cancel("b", "short")
        desk.result("b", "short")
