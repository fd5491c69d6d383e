"""Every robot has one colour, whatever else takes part and wherever it is drawn."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from nufleet.orchestrator.flights.colours import WITHOUT_SOURCE, robot_colours
from nufleet.orchestrator.runs.figures import prior_colours
from nufleet.orchestrator.viewer.draw.palette import Palette

NAMES = st.from_regex(r"[a-z]{1,6}(-[0-9]{1,2})?", fullmatch=True)


@given(st.sets(NAMES, max_size=40))
def test_no_two_robots_share_a_colour(robots: set[str]) -> None:
    colours = robot_colours(robots)
    assert colours.keys() == robots
    for ground in ("on_light", "on_dark"):
        assert len({getattr(colour, ground) for colour in colours.values()}) == len(robots)


@given(st.sets(st.integers(1, 7), min_size=1))
def test_numbered_robots_keep_their_colours_in_any_company(numbers: set[int]) -> None:
    fleet = robot_colours(f"source-{k}" for k in range(1, 8))
    some = {f"source-{k}" for k in numbers}
    assert robot_colours(some) == {robot: fleet[robot] for robot in some}


@given(st.sets(NAMES, min_size=1, max_size=12))
def test_the_viewer_and_the_figures_give_a_robot_the_same_colour(robots: set[str]) -> None:
    palette = Palette()
    palette.assign("the target", robots)
    drawn = prior_colours(robots)
    for robot, colour in robot_colours(robots).items():
        assert palette.of(robot) == colour.on_dark
        assert drawn[robot] == "#{:02x}{:02x}{:02x}".format(*colour.on_light)
    for name, colour in WITHOUT_SOURCE.items():
        assert palette.of_prior(name) == colour.on_dark
