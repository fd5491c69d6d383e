"""A robot is begun once before its motions and ended once after them, whatever fails."""

from __future__ import annotations

import numpy as np
import pytest
from puppet_robot import PuppetRobot

from nufleet.robot_agent.motion.pace import HaltSwitch
from nufleet.robot_agent.motion.perform import Played, Samples
from nufleet.robot_agent.motion.sortie import Sortie
from nufleet.robot_agent.motion.steps import Steps, make
from nufleet.shared.errors import RobotDownError, RobotError
from nufleet.shared.wire.messages import Outcome


@pytest.fixture
def robot() -> PuppetRobot:
    robot = PuppetRobot()
    robot.connect()
    return robot


def fails(error: Exception) -> None:
    raise error


def test_a_robot_is_begun_once_and_ended_once(robot: PuppetRobot) -> None:
    sortie = Sortie(robot)
    assert make(sortie.end()) is None
    assert robot.ended == 0
    make(sortie.begin())
    make(sortie.begin())
    assert (sortie.begun, robot.begun) == (True, 1)
    assert make(sortie.end()) is None
    assert make(sortie.end()) is None
    assert (sortie.begun, robot.ended) == (False, 1)
    make(sortie.begin())
    assert robot.begun == 2


@pytest.mark.parametrize("error", [RobotError("no GPS"), OSError("no GPS")])
def test_a_robot_that_half_began_is_ended_and_may_try_again(
    robot: PuppetRobot, error: Exception
) -> None:
    robot.on_begin = lambda: fails(error)
    sortie = Sortie(robot)
    with pytest.raises(RobotError, match=r"could not get ready to move: .*no GPS") as raised:
        make(sortie.begin())
    assert not isinstance(raised.value, RobotDownError)
    assert (sortie.begun, robot.ended) == (False, 1)
    robot.on_begin = lambda: None
    make(sortie.begin())
    assert sortie.begun


def test_a_robot_that_can_neither_begin_nor_end_is_down(robot: PuppetRobot) -> None:
    robot.on_begin = lambda: fails(RobotError("no GPS"))
    robot.on_end = lambda: fails(RobotError("no landing"))
    with pytest.raises(RobotDownError, match="no GPS; could not be ended: no landing"):
        make(Sortie(robot).begin())


def test_a_robot_that_cannot_be_ended_says_why_and_is_not_asked_again(robot: PuppetRobot) -> None:
    robot.on_end = lambda: fails(OSError("broken"))
    sortie = Sortie(robot)
    make(sortie.begin())
    assert make(sortie.end()) == "could not be ended: OSError('broken')"
    assert make(sortie.end()) is None
    assert robot.ended == 1


def test_a_process_that_was_frozen_while_its_robot_took_off_begins_no_motion(
    robot: PuppetRobot,
) -> None:
    sortie, nothing = Sortie(robot), Samples(np.empty(0), np.empty(0))

    def performed() -> Steps[Played]:
        yield lambda: pytest.fail("it moves")
        return Played(Outcome.COMPLETED, "", nothing)

    hindrances = iter([None, "it was frozen"])
    played = make(sortie.move(HaltSwitch(), lambda: next(hindrances), nothing, performed))
    assert (played.outcome, played.reason) == (Outcome.ABORTED, "it was frozen")
    assert (sortie.begun, robot.begun, robot.ended) == (True, 1, 0)


def test_a_process_that_was_frozen_before_its_robot_takes_off_leaves_it_on_the_ground(
    robot: PuppetRobot,
) -> None:
    sortie, nothing = Sortie(robot), Samples(np.empty(0), np.empty(0))
    stays = make(
        sortie.move(HaltSwitch(), lambda: "it was frozen", nothing, lambda: pytest.fail("it moves"))
    )
    assert (stays.outcome, stays.reason) == (Outcome.ABORTED, "it was frozen")
    assert (sortie.begun, robot.begun) == (False, 0)


def test_a_robot_that_is_stopped_while_it_takes_off_knows_it_and_lands(robot: PuppetRobot) -> None:
    sortie, nothing, switch = Sortie(robot), Samples(np.empty(0), np.empty(0)), HaltSwitch()
    called_off: list[bool] = []

    def taking_off() -> None:
        called_off.append(robot.called_off())
        switch.halt(Outcome.ABORTED, "stopped by hand")
        called_off.append(robot.called_off())

    def performed() -> Steps[Played]:
        yield lambda: pytest.fail("it moves")
        return Played(Outcome.COMPLETED, "", nothing)

    robot.on_begin = taking_off
    played = make(sortie.move(switch, lambda: None, nothing, performed))
    assert called_off == [False, True]
    assert (played.outcome, played.reason, played.fault) == (
        Outcome.ABORTED,
        "stopped by hand",
        None,
    )
    assert (sortie.begun, robot.begun, robot.ended) == (False, 1, 1)


def test_a_robot_that_stays_on_the_ground_for_a_stop_was_stopped_and_did_not_fail(
    robot: PuppetRobot,
) -> None:
    sortie, nothing, switch = Sortie(robot), Samples(np.empty(0), np.empty(0)), HaltSwitch()

    def staying() -> None:
        switch.halt(Outcome.ABORTED, "stopped by hand")
        raise RobotError("it was called off before take-off")

    robot.on_begin = staying
    played = make(sortie.move(switch, lambda: None, nothing, lambda: pytest.fail("it moves")))
    assert (played.outcome, played.reason) == (Outcome.ABORTED, "stopped by hand")
    assert (sortie.begun, robot.ended) == (False, 1)


@pytest.mark.parametrize("released", [True, False])
def test_a_robot_that_is_stopped_as_it_is_disconnected_is_not_connected(
    robot: PuppetRobot, released: bool
) -> None:
    calls: list[str] = []
    robot.on_disconnect = lambda: calls.append("disconnect")
    robot.on_connect = lambda: calls.append("connect")
    make(Sortie(robot).reconnect(lambda: released))
    assert calls == ["disconnect", *["connect"] * released]
