"""Pages that tell how to begin, followed from top to bottom by a reader with an empty folder."""

from __future__ import annotations

from pathlib import Path

from page_story import Story


def test_a_new_robot_is_written_installed_checked_and_ranked(tmp_path: Path) -> None:
    with Story(tmp_path) as story:
        shown = story.follow("docs/your-robot.md")
    assert "16 of 16 statements hold for my_drone" in shown
    assert list(tmp_path.glob("runs/*/results.json"))


def test_a_fleet_is_closed_and_its_robot_gets_an_identity(tmp_path: Path) -> None:
    with Story(tmp_path) as story:
        story.follow("docs/security.md")
    known = {path.name for path in (tmp_path / ".config" / "nufleet").iterdir()}
    assert {"drone-7.key", "drone-7.nufleet", "desk.key", "desk.nufleet"} <= known
