"""What a flight of a Crazyflie decides, with a link that only notes what is sent."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from nufleet.robot_agent.drivers.crazyflie import flight
from nufleet.robot_agent.drivers.crazyflie.flight import Flight
from nufleet.robot_agent.drivers.crazyflie.settings import CrazyflieSettings
from nufleet.robot_agent.drivers.crazyflie.supervisor import Supervisor
from nufleet.robot_agent.drivers.crazyflie.telemetry import Telemetry
from nufleet.shared.errors import OutsideLimitsError, RobotDownError, RobotError
from nufleet.sims.crazyflies.firmware import compressed

READY = Supervisor.ARMED | Supervisor.CAN_FLY
UPRIGHT = float(compressed([0.0, 0.0, 0.0, 1.0]))


class NotingLink:
    """Notes the names of the commands; the drone obeys as a test says."""

    lost = None

    def __init__(self) -> None:
        self.sent: list[str] = []
        self.obeys: dict[str, Any] = {}

    def __getattr__(self, name: str) -> Any:
        def send(*_: object, **named: object) -> None:
            self.sent.append(f"{name} {named}" if named else name)
            self.obeys.get(self.sent[-1], lambda: None)()

        return send


class Ground:
    """A flight that has not begun, of a drone whose log a test writes."""

    def __init__(self, **settings: Any) -> None:
        self.link, self.telemetry = NotingLink(), Telemetry(0.01)
        given = {"uri": "udp://127.0.0.1:19850", "estimator": None, **settings}
        chosen = CrazyflieSettings.model_validate(given)
        self.stamp_ms = 0
        self.log()
        self.flight = Flight("cf", chosen, self.link, self.telemetry)  # type: ignore[arg-type]

    def log(self, x: float = 0.0, y: float = 0.0, z: float = 0.0, info: int = 1) -> None:
        self.stamp_ms += 10
        speeds = {f"stateEstimate.{name}": 0.0 for name in ("vx", "vy", "vz")}
        places = {"stateEstimate.x": x, "stateEstimate.y": y, "stateEstimate.z": z}
        now_s = time.monotonic()
        state = {**places, **speeds, "stateEstimateZ.quat": UPRIGHT}
        self.telemetry.take_state(self.stamp_ms, state, now_s)
        variances = {f"kalman.var{axis}": 1e-4 for axis in ("PX", "PY", "PZ")}
        self.telemetry.take_status({"pm.vbat": 4.0, "supervisor.info": info, **variances}, now_s)


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> Iterator[list[Ground]]:
    monkeypatch.setattr(flight, "UNMEASURED_MAX_S", 60.0)
    monkeypatch.setattr(flight, "HOLD_INTERVAL_S", 60.0)  # nothing is repeated
    monkeypatch.setattr(flight, "AGAIN_S", 0.01)
    monkeypatch.setattr(Flight, "next", Flight.newest)
    grounds: list[Ground] = []
    yield grounds
    for ground in grounds:
        ground.flight.release()


@pytest.fixture
def ground(made: list[Ground]) -> Ground:
    made.append(Ground())
    return made[0]


ARM, DISARM = "arm {'armed': True}", "arm {'armed': False}"


def test_a_drone_that_arms_without_being_able_to_fly_is_disarmed(
    ground: Ground, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(flight, "ARMING_MAX_S", 0.05)
    ground.link.obeys = {ARM: lambda: ground.log(info=Supervisor.ARMED), DISARM: ground.log}
    with pytest.raises(RobotError, match="cf does not arm: its supervisor says"):
        ground.flight.take_off(lambda: None)
    assert ground.link.sent[0] == ARM
    assert ground.link.sent[-1] == DISARM
    assert not ground.flight.airborne


def test_a_drone_that_is_stopped_once_it_is_armed_is_disarmed_and_its_motors_do_not_spin_up(
    ground: Ground,
) -> None:
    ground.link.obeys = {ARM: lambda: ground.log(info=READY), DISARM: ground.log}
    answers = iter([False])

    def check_wanted() -> None:
        if next(answers, True):
            raise RobotError("it was stopped before it took off")

    with pytest.raises(RobotError, match="stopped before it took off"):
        ground.flight.take_off(check_wanted)
    assert ground.link.sent == [ARM, "stop_motors", DISARM]
    assert not ground.flight.airborne


def test_no_command_follows_the_one_that_cuts_the_motors(ground: Ground) -> None:
    ground.link.obeys = {ARM: ground.flight.cut_motors}
    with pytest.raises(RobotDownError, match="its motors were cut"):
        ground.flight.take_off(lambda: None)
    assert ground.link.sent == [ARM, "cut_motors"]


@pytest.mark.parametrize(
    ("place", "says"),
    [
        ({"y": 1.2, "z": 0.5}, r"\+1\.20 m off its y; 1 m are allowed \(limits.fence_m\)"),
        ({"z": 0.1}, r"-0\.40 m off its height; 0\.3 m are allowed \(limits.height_error_m\)"),
    ],
)
def test_a_drone_that_leaves_its_place_along_what_is_no_axis_ends_its_motion(
    made: list[Ground], place: dict[str, float], says: str
) -> None:
    ground = Ground(axes=("x",))
    made.append(ground)
    ground.log(x=2.0, y=0.9, z=0.5, info=READY)  # the agent watches x itself
    ground.flight.check(ground.flight.newest())
    ground.log(**place, info=READY)
    with pytest.raises(OutsideLimitsError, match=says):
        ground.flight.check(ground.flight.newest())


def test_a_drone_whose_position_has_jumped_is_not_flown_by_the_jump(ground: Ground) -> None:
    ground.flight.send(np.array([0.3, 0.0, 0.0]), np.zeros(3))
    ground.log(x=-0.6, z=0.5, info=READY)
    ground.flight.check_near()
    ground.log(x=-0.8, z=0.5, info=READY)
    for use in (ground.flight.check_near, ground.flight.wait_until_still):
        with pytest.raises(
            OutsideLimitsError, match=r"1\.10 m away from its set-point, .* 1 m are"
        ):
            use()
