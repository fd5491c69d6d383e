"""A Crazyflie flown through Bitcraze's cflib, against a drone's side of the protocol."""

from __future__ import annotations

import shlex
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from crazyflie_bench import Bench, bench
from polling import wait_until

from nufleet.robot_agent.driver_kit.check import check_robot
from nufleet.robot_agent.drivers.crazyflie import flight, link
from nufleet.robot_agent.drivers.crazyflie.motion_capture import MotionCapture, Sighting
from nufleet.robot_agent.drivers.crazyflie.robot import Crazyflie
from nufleet.robot_agent.drivers.crazyflie.settings import (
    CrazyflieSettings,
    MotionCaptureSettings,
)
from nufleet.robot_agent.motion.resampling import outputs_at_samples
from nufleet.shared.command_line import command_line
from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError
from nufleet.sims.crazyflies import firmware
from nufleet.sims.crazyflies.peer import Air

cflib = pytest.importorskip("cflib")

STOP, LAND = 3, 8
"""Commands of the high-level commander."""


@pytest.fixture(autouse=True)
def _nothing_is_left_running() -> Iterator[None]:
    threads = set(threading.enumerate())
    yield
    wait_until(lambda: set(threading.enumerate()) <= threads)


def test_the_driver_keeps_the_contract_of_a_robot_to_the_last_statement() -> None:
    with bench(noise_m=0.0005) as lab:
        report = check_robot(lab.robot, cuts=True)
        # How long something took is the machine's affair as well.
        broken = [one for one in report.failed if " took " not in one.observed]
        assert not broken, str(report)
        assert None not in {one.holds for one in report.examined}
        assert lab.drone.locked
        assert lab.drone.parameters["stabilizer.estimator"] == 1


def test_a_flight_over_a_late_and_lossy_link_is_recorded_by_the_drones_own_clock() -> None:
    with bench() as lab:
        lab.robot.connect()
        lab.robot.begin()
        lab.peer.air = Air(jitter_s=0.008, loss=0.01)
        lab.fly(50, 0.1)
        record = lab.robot.record()
        lab.robot.rest()
    outputs, _ = outputs_at_samples(record, 50, lab.robot.spec)
    assert outputs.shape == (50, 2)
    # The drone measures every 10 ms, however irregularly that arrives.
    ticks = np.diff(record.measured_s) / 0.01
    assert np.abs(ticks - np.rint(ticks)).max() < 0.15


def test_set_points_arrive_at_their_rate_and_to_the_nearest_millimetre_until_it_lands() -> None:
    with bench() as lab:
        lab.robot.connect()
        lab.robot.begin()
        before = lab.drone.setpoints
        lab.robot.run(np.tile([0.0296, -0.0296], (50, 1)))
        wait_until(lambda: lab.drone.setpoints >= before + 50)
        assert lab.drone._target[0] == pytest.approx([0.03, -0.03, 0.5])
        sent_s = lab.robot.record().sample_s
        assert len(sent_s) == 50
        assert sent_s[-1] - sent_s[0] > 0.8 * 49 * 0.02
        # Between motions the last set-point is repeated, or the firmware would switch off.
        count = lab.drone.setpoints
        wait_until(lambda: lab.drone.setpoints > count + 10)
        assert lab.robot.health().ready
        lab.drone.ailments.battery_v = 3.1
        wait_until(lambda: "its battery is empty: 3.10 V" in lab.robot.health().reason)
        lab.robot.rest()
        lab.robot.end()
        assert not lab.drone.armed
        wait_until(lambda: lab.drone.plant.position_m[2] == 0.0)


def test_position_set_points_are_sent_as_they_are() -> None:
    with bench(setpoint="position", axes=("z", "x"), tracking=None) as lab:
        lab.robot.connect()
        lab.robot.begin()
        lab.robot.run(np.tile([0.0504, 0.0204], (2, 1)))
        wait_until(lambda: lab.drone._target[0][0] != 0)
        assert lab.drone._target[0] == pytest.approx([0.0204, 0.0, 0.5504])
        states = lab.robot.observe()
        assert states.shape == (2, 3)
        assert lab.robot.step(np.zeros(2)).tolist() == states[:, 0].tolist()


def test_half_a_second_of_silence_ends_the_motion_and_the_drone_rests(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(firmware, "SWITCH_OFF_S", 60.0)
    with bench(patience_s=None) as lab:
        lab.robot.connect()
        lab.robot.begin()
        lab.peer.fall_silent(0.6)
        with pytest.raises(
            RobotError, match=r"no measurement for 0\.3 s: check the link"
        ) as raised:
            lab.fly(500)
        assert not isinstance(raised.value, RobotDownError)
        lab.robot.rest()
        wait_until(lambda: lab.robot.health().ready)


def test_two_seconds_of_silence_take_it_down_and_it_says_what_to_do() -> None:
    with bench(patience_s=None) as lab:
        lab.robot.connect()
        lab.robot.begin()
        lab.peer.fall_silent(2.5)
        with pytest.raises(RobotError):
            lab.fly(500)
        wait_until(lambda: lab.drone.locked)
        wait_until(lambda: "it is locked" in lab.robot.health().reason)
        for use in (lab.robot.rest, lab.robot.end):
            with pytest.raises(RobotDownError, match="switch it off and on"):
                use()
        lab.robot.connect()  # the link is well
        with pytest.raises(RobotError, match="does not take off: it is locked"):
            lab.robot.begin()


def test_an_emergency_stop_from_another_thread_cuts_the_motors() -> None:
    with bench() as lab:
        lab.robot.connect()
        lab.robot.begin()
        killer = threading.Timer(0.1, lab.robot.kill)
        killer.start()
        with pytest.raises(RobotDownError, match="its motors were cut"):
            lab.fly(5000)
        killer.join()
        wait_until(lambda: lab.drone.locked and lab.drone.plant.position_m[2] == 0.0)
        assert lab.robot.health().reason == "its motors were cut"


def test_an_emergency_stop_is_repeated_until_the_supervisor_confirms_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(link, "STOP_INTERVAL_S", 0.002)
    with bench() as lab:
        lab.robot.connect()
        obey, lost = lab.drone._obey_supervisor, iter(range(60))
        monkeypatch.setattr(
            lab.drone,
            "_obey_supervisor",
            lambda data: None if data[0] == 3 and next(lost, None) is not None else obey(data),
        )
        lab.robot.kill()
        wait_until(lambda: lab.drone.locked)
        wait_until(lambda: not any("-stop" in one.name for one in threading.enumerate()))


def test_a_drone_that_is_in_the_air_when_it_is_connected_is_left_alone_until_it_has_landed() -> (
    None
):
    with bench(estimator="kalman", parameters={"posCtlPid.xKp": 1.8}) as lab:
        lab.drone.armed = lab.drone.thrusting = True
        lab.drone.plant.position_m[2] = 0.5
        lab.drone._target = (lab.drone.plant.position_m.copy(), np.zeros(3))
        lab.robot.connect()
        with pytest.raises(
            RobotError, match="does not take off: it was in the air when it was con"
        ):
            lab.robot.begin()
        assert lab.drone.parameters["posCtlPid.xKp"] == 0.0
        assert lab.drone.parameters["stabilizer.estimator"] == 0
        lab.drone._stop(locked=False)
        wait_until(lambda: lab.robot.health().ready)
        lab.robot.begin()
        assert lab.drone.parameters["posCtlPid.xKp"] == pytest.approx(1.8)
        assert lab.drone.parameters["stabilizer.estimator"] == 2


def test_closing_a_link_sends_no_zero_thrust_to_a_drone_that_may_fly() -> None:
    with bench() as lab:
        lab.robot.connect()
        radio, ports = lab.robot._link._cf.link, []  # type: ignore[union-attr]
        send = radio.send_packet
        radio.send_packet = lambda packet: (ports.append(packet.port), send(packet))
        lab.robot.disconnect()
    assert cflib.crtp.crtpstack.CRTPPort.LOGGING in ports
    assert cflib.crtp.crtpstack.CRTPPort.COMMANDER not in ports


def test_a_set_point_that_cannot_be_repeated_is_reported_and_tried_again(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def fail(*_: object) -> None:
        raise OSError("the queue is full")

    with bench() as lab:
        lab.robot.connect()
        held = lab.robot._flight
        assert held is not None
        held.send(np.zeros(3), np.zeros(3))
        with monkeypatch.context() as broken:
            broken.setattr(lab.robot._link, "send_setpoint", fail)
            wait_until(
                lambda: (
                    lab.robot.health().reason
                    == "its set-points are not repeated: the queue is full"
                )
            )
        wait_until(lambda: lab.robot.health().ready)


def test_a_drone_that_loses_its_height_lands(monkeypatch: pytest.MonkeyPatch) -> None:
    with bench() as lab:
        lab.robot.connect()
        lab.robot.begin()
        plant = lab.drone.plant
        follow = plant.follow
        monkeypatch.setattr(plant, "follow", lambda *_: None)
        plant.position_m = np.array([0.0, 0.0, 1.2])
        with pytest.raises(OutsideLimitsError, match=r"\+\d\.\d+ m off its height; 0\.3 m"):
            lab.fly(500)
        monkeypatch.setattr(plant, "follow", follow)
        lab.robot.rest()
        lab.robot.end()


def test_the_watchdog_is_fed_from_take_off_until_it_is_disconnected() -> None:
    with bench(watchdog=True) as lab:
        lab.robot.connect()
        assert lab.drone._watched_s is None
        lab.robot.begin()
        lab.robot.end()
        assert lab.drone._watched_s is not None
        fed_s = lab.drone._watched_s
        wait_until(lambda: (lab.drone._watched_s or 0.0) > fed_s + 1.0)
        assert not lab.drone.locked


def test_a_second_drone_with_its_address_in_flight_ends_the_motion_and_it_lands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(flight, "BLIND_S", 0.2)
    with bench() as lab:
        lab.robot.connect()
        lab.robot.begin()
        be_two(lab)
        with pytest.raises(RobotError, match="two drones"):
            lab.fly(5000)
        with pytest.raises(RobotError, match=r"cf was landed unseen: .*two drones"):
            lab.robot.end()
        wait_until(lambda: not lab.drone.armed)


def stop_measuring(lab: Bench) -> None:
    """Its status arrives, its states do not."""
    states = max(lab.drone._blocks.values(), key=lambda block: len(block.variables))
    states.period_s = 0.0


def lose_position(lab: Bench) -> None:
    lab.drone.ailments.lost = True


def be_two(lab: Bench) -> None:
    """Another drone with the same address, switched on a minute earlier."""
    count = iter(range(10**9))
    lab.drone.ailments.stamp_ms = lambda ms: ms + 60_000 * (next(count) % 2)


@pytest.mark.parametrize(
    ("ail", "landing", "says"),
    [(stop_measuring, False, "no measurement for"), (be_two, True, "two drones")],
)
def test_a_drone_that_is_measured_no_more_before_or_while_it_lands_is_landed_by_the_clock(
    monkeypatch: pytest.MonkeyPatch, ail: Callable[[Bench], None], landing: bool, says: str
) -> None:
    obeyed: list[int] = []
    with bench() as lab:
        lab.robot.connect()
        lab.robot.begin()
        held, obey = lab.robot._flight, lab.drone._take_high_level
        assert held is not None

        def take(data: bytes) -> None:
            if landing and not obeyed:
                ail(lab)
            obeyed.append(data[0])
            obey(data)

        with monkeypatch.context() as hasty:
            hasty.setattr(lab.drone, "_take_high_level", take)
            hasty.setattr(flight, "BLIND_S", 0.2)
            if not landing:
                ail(lab)
                hasty.setattr(flight, "UNMEASURED_MAX_S", 0.2)
                hasty.setattr(flight, "PATIENCE_S", 0.2)
                wait_until(lambda: not held.measured)
            with pytest.raises(RobotError, match=f"cf was landed unseen: .*{says}"):
                lab.robot.end()
            wait_until(lambda: not lab.drone.armed)
    assert obeyed[0] == LAND
    assert obeyed[-1] == STOP


def turn_left(lab: Bench) -> None:
    lab.drone.plant.quaternion = np.array([0.0, 0.0, 1.0, 1.0]) / np.sqrt(2)


def be_called_off(lab: Bench) -> None:
    lab.robot.called_off = lambda: True


def go_empty(lab: Bench) -> None:
    lab.drone.ailments.battery_v = 3.0


@pytest.mark.parametrize(
    ("settings", "ail", "says"),
    [
        ({}, go_empty, "does not take off: its battery is empty: 3.00 V"),
        ({"estimator": "kalman"}, lose_position, "it does not know its position"),
        ({}, be_two, "two drones"),
        ({}, be_called_off, "it was stopped before it took off"),
        ({}, turn_left, "cf is turned by 90 degrees"),
        ({"origin_m": (3.0, 0.0, 0.5)}, None, r"stands at \(0\.03, -0\.02\) m, 2\.97 m from its"),
        ({"parameters": {"posCtlPid.yKp": 2.0}}, None, "no parameter 'posCtlPid.yKp'"),
    ],
)
def test_what_is_wrong_is_said_before_anything_moves(
    settings: dict[str, Any], ail: Callable[[Bench], None] | None, says: str
) -> None:
    with bench(**settings) as lab:
        if ail is not None:
            ail(lab)

        def go() -> None:
            lab.robot.connect()
            lab.robot.begin()

        with pytest.raises(RobotError, match=says):
            go()
        assert not lab.drone.armed
        assert not lab.drone.thrusting


def test_an_estimate_that_does_not_settle_is_said_before_it_arms(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(flight, "PATIENCE_S", 0.3)
    with bench(estimator="kalman", start={"position_m": (0.1, 0.2, 0.0)}) as lab:
        lab.robot.connect()
        wait_until(lambda: lab.robot.health().ready)
        lab.drone._variance_m2 = lambda: 0.2 * np.random.default_rng().random()  # type: ignore[method-assign]
        with pytest.raises(RobotError, match="does not find out where it is"):
            lab.robot.begin()
        assert not lab.drone.armed
        names = [f"kalman.initial{axis}" for axis in ("X", "Y", "Z")]
        assert [lab.drone.parameters[name] for name in names] == pytest.approx([0.1, 0.2, 0.0])


@pytest.mark.parametrize(
    ("uri", "says"),
    [
        ("udp://127.0.0.1:9", "udp://127.0.0.1:9: "),
        ("radio://0/80/2M", "no Crazyradio: .* Plug it in"),
    ],
)
def test_a_drone_that_cannot_be_reached_is_named(uri: str, says: str) -> None:
    robot = Crazyflie("cf", CrazyflieSettings(uri=uri))
    with pytest.raises(RobotError, match=says):
        robot.connect()
    with pytest.raises(RobotError, match="cf is not connected"):
        robot.kill()
    assert robot.health().reason == "it is not connected"


def test_motion_capture_tells_the_drone_where_it_is_until_it_is_blind() -> None:
    frames = threading.Semaphore(0)
    turned = SimpleNamespace(x=0.0, y=0.0, z=0.0, w=1.0)
    seen = {"cf": SimpleNamespace(position=[0.03, -0.02, 0.0], rotation=turned)}
    system = SimpleNamespace(waitForNextFrame=frames.acquire, rigidBodies=seen)
    capture = MotionCapture("vicon", "mocap", lambda *_: system)
    seen_by = MotionCaptureSettings(system="vicon", hostname="mocap", body="cf", rate_hz=200.0)
    with bench(estimator="kalman", sighting=Sighting(seen_by, capture), patience_s=0.7) as lab:
        lab.drone.ailments.needs_poses = True
        over = threading.Event()

        def film() -> None:
            while not over.wait(0.01):
                frames.release()

        filming = threading.Thread(target=film)
        filming.start()
        try:
            lab.robot.connect()
            wait_until(lambda: lab.robot.health().ready)
            lab.robot.begin()
            assert lab.drone.poses[0] == pytest.approx((0.03, -0.02, 0.0))
            lab.robot.end()
        finally:
            over.set()
            filming.join()
        wait_until(lambda: "motion capture does not see body 'cf'" in lab.robot.health().reason)
    frames.release()


def test_two_drones_fly_side_by_side_in_one_process() -> None:
    with bench() as one, bench() as two:
        for lab in (one, two):
            lab.robot.connect()
        flights = [threading.Thread(target=lab.robot.begin) for lab in (one, two)]
        for take_off in flights:
            take_off.start()
        for take_off in flights:
            take_off.join()
        one.robot.run(np.tile([0.05, 0.0], (3, 1)))
        assert two.drone._target[0] == pytest.approx([0.0, 0.0, 0.5])


def test_a_connection_that_loses_packets_is_made_all_the_same() -> None:
    with bench(air=Air(loss=0.04)) as lab:
        lab.robot.connect()
        assert lab.robot.health().battery is not None


PLAY = "python -m nufleet.sims.crazyflies --port 19850"
CHECK = """nufleet robot check crazyflie --settings 'uri = "udp://127.0.0.1:19850"' --still"""


def test_the_commands_of_the_page_check_a_simulated_drone() -> None:
    words = shlex.split(PLAY.replace("19850", "0"))
    with subprocess.Popen(
        [sys.executable, *words[1:]], stderr=subprocess.PIPE, text=True
    ) as played:
        assert played.stderr is not None
        uri = played.stderr.readline().split()[-1]
        try:
            words = shlex.split(CHECK.replace("udp://127.0.0.1:19850", uri))
            checked = CliRunner().invoke(command_line(), words[1:])
        finally:
            played.terminate()
            played.communicate()
    assert checked.exit_code == 0, checked.output
    assert (
        "ok   It connects, and a robot that was connected before connects again." in checked.output
    )
    assert "not checked, since the robot is not to be moved" in checked.output


def test_a_packet_that_is_sent_as_the_link_is_closed_is_no_error_of_the_link(
    caplog: pytest.LogCaptureFixture,
) -> None:
    from cflib.crtp.crtpstack import CRTPPacket

    closed: list[bool] = []
    with bench() as lab:
        lab.robot.connect()
        udp = lab.robot._link._cf.link
        real = udp.socket

        class Sending:
            """A socket over which another thread sends when it has just been closed."""

            def __getattr__(self, name: str) -> Any:
                return getattr(real, name)

            def close(self) -> None:
                real.close()
                closed.append(True)
                udp.send_packet(CRTPPacket())

        udp.socket = Sending()
    assert closed == [True]
    assert "link error" not in caplog.text
