"""Two agent processes that serve one robot: both are found, and neither moves."""

from __future__ import annotations

import pytest

from benchmarks.faults.lab import KEYS, Lab
from benchmarks.faults.program import PATIENCE_S, wait_until
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.shared.errors import RefusedError, RobotLostError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.codec import decode, encode
from nufleet.shared.wire.messages import GoalRequest, Outcome, Refusal
from nufleet.shared.wire.transport import open_client

SHORT = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)


def test_two_agents_of_one_robot_both_refuse_until_one_has_ended(lab: Lab) -> None:
    lab.describe_section_v({"a": 0.9})
    lab.router()
    lab.agent("a")
    other = lab.agent("a", state_folder=lab.folder / "elsewhere")
    fleet = lab.orchestrator("a", name="asker")
    request = GoalRequest(goal_id="g", owner="asker", motion=SHORT)
    with open_client(lab.endpoint, timeout_s=PATIENCE_S) as session:

        def refusals() -> list[Refusal]:
            key = KEYS.command("a", request.owner, "goal")
            replies = session.ask_all(key, encode(request), timeout_s=PATIENCE_S)
            answers = [decode(reply, Refusal) for reply in replies]
            return [answer for answer in answers if answer.code == "two-agents"]

        # A goal that neither takes: its robot would have to move before the two know of each other.
        request = request.model_copy(update={"owner": "nobody"})
        wait_until(lambda: len(refusals()) == 2)
        request = request.model_copy(update={"owner": "asker"})
        assert all("also serves a; end one of the two" in refusal.reason for refusal in refusals())
    for ask in (lambda: fleet.describe("a"), lambda: fleet.submit("a", request)):
        with pytest.raises(RobotLostError, match="2 agents answer as a: stop all but one of them"):
            ask()
    assert lab.motions("a") == []
    other.kill()

    def taken() -> bool:
        try:
            fleet.submit("a", request)
        except (RefusedError, RobotLostError):
            return False
        return True

    wait_until(taken)
    assert GoalRunner(fleet).run("a", "g", SHORT).outcome is Outcome.COMPLETED
    assert len(lab.motions("a")) == 1
