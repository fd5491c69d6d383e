"""An agent whose disk is full: what cannot be stored is not done, and said."""

from __future__ import annotations

import subprocess
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from benchmarks.faults.lab import Lab
from nufleet.orchestrator.fleet.goal_runner import GoalRunner
from nufleet.shared.errors import RefusedError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.wire.messages import GoalRequest, Outcome, RobotStatus

SHORT = Excitation(axis="x", tones=(Tone(omega_rad_s=20.0),), settle_s=0.5)


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    folder = tmp_path / "small"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    done = subprocess.run(mount, capture_output=True, text=True)
    assert done.returncode == 0, f"cannot mount a file system; run the tests as root: {done.stderr}"
    yield folder
    subprocess.run(["umount", "--lazy", str(folder)], check=True)


def test_a_goal_that_the_disk_has_no_room_for_is_refused_and_moves_nothing(
    small_disk: Path, lab: Lab
) -> None:
    lab.describe_section_v({"a": 0.9})
    lab.router()
    lab.agent("a", state_folder=small_disk)
    fleet = lab.orchestrator("a")
    ballast = small_disk / "ballast"
    with pytest.raises(OSError, match="No space left"):
        ballast.write_bytes(bytes(2 * 2**20))
    number, refused = 0, None
    # What the journal made room for beforehand is used up first.
    while refused is None and number < 2000:
        number += 1
        request = GoalRequest(goal_id=f"g{number}", owner=fleet.orchestrator_id, motion=SHORT)
        try:
            GoalRunner(fleet).run("a", request.goal_id, request.motion)
        except RefusedError as error:
            refused = error
    assert refused is not None
    assert refused.code == "journal"
    assert "No space left" in refused.reason
    assert len(lab.motions("a")) == number - 1
    # It halts all the same, whether or not there is room to remember that.
    with suppress(RefusedError):
        fleet.stop("a", "smoke")
    lab.wait_for_state(fleet, "a", lambda state: state.status is RobotStatus.STOPPED)
    ballast.unlink()
    fleet.release("a")
    assert GoalRunner(fleet).run("a", "after", SHORT).outcome is Outcome.COMPLETED
    assert len(lab.motions("a")) == number
