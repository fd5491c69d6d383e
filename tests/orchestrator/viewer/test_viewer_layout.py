"""Which views a recording opens with."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import rerun.blueprint as rrb
from recording_reader import layouts
from study_events import iteration_event, samples_event, state_event
from tracking_events import flight

from nufleet.orchestrator.viewer.events import ViewerEvent
from nufleet.orchestrator.viewer.layout import layout
from nufleet.orchestrator.viewer.shown import COMPARED_S, Shown
from nufleet.orchestrator.viewer.writer import RerunWriter

STUDY_VIEWS = {"Ranking", "Robots", "Log", "Responses on the Riemann sphere"}
FLIGHT_VIEWS = {"Tracking", "Flights", "Log", "Tracking error |e| [mm], by source of the prior"}
PATHS = "Path: desired (thin), current flight (bright), earlier flights"
POSITION = "Position [m]: desired (grey) and actual"


def laid_out(path: Path, *events: ViewerEvent) -> list[set[str]]:
    with RerunWriter("run-1", recording=path, serve=None) as writer:
        for event in events:
            writer.emit(event)
    return layouts(path)


def test_a_study_is_laid_out_once(tmp_path: Path) -> None:
    (views,) = laid_out(tmp_path / "run.rrd", state_event("s1", 0.0), samples_event("s1"))
    assert views >= STUDY_VIEWS
    assert not views & (FLIGHT_VIEWS - STUDY_VIEWS)


def test_flights_alone_show_no_study(tmp_path: Path) -> None:
    events = (state_event("target", 0.0), flight("baseline"), flight("s1", t_s=15.0))
    _, views = laid_out(tmp_path / "run.rrd", *events)
    assert views >= {*FLIGHT_VIEWS, PATHS}
    assert not views & (STUDY_VIEWS - FLIGHT_VIEWS)


def test_a_study_and_its_flights_are_tabs_with_the_latest_in_front(tmp_path: Path) -> None:
    _, views = laid_out(tmp_path / "run.rrd", iteration_event(), flight(t_s=20.0))
    assert views >= STUDY_VIEWS | FLIGHT_VIEWS
    shown = Shown()
    shown.ranking()
    shown.tracking(("x", "y"), "m", 20.0)
    tabs = layout(shown).root_container
    assert isinstance(tabs, rrb.Tabs)
    assert [tab.name for tab in tabs.contents] == ["Ranking", "Tracking"]
    assert tabs.active_tab == 1


def test_a_robot_with_one_axis_gets_a_plot_over_time_instead_of_a_path(tmp_path: Path) -> None:
    _, views = laid_out(tmp_path / "run.rrd", flight(axes=("x",)))
    assert POSITION in views
    assert PATHS not in views


def test_every_axis_has_a_view_of_its_inverse_model(tmp_path: Path) -> None:
    axes = tuple(f"joint-{n}" for n in range(6))
    _, views = laid_out(tmp_path / "run.rrd", flight(axes=axes, unit="rad"))
    for axis in axes:
        assert f"Inverse model, {axis} [rad/s]: prior (grey) and online GP ± 2σ" in views


def test_a_mixture_gets_a_view_of_its_weights(tmp_path: Path) -> None:
    view = "Weights of the mixture, by source"
    mixed = replace(
        flight("mixture", samples=50), experts=("s1",), weights=np.tile([0.7, 0.3], (50, 1))
    )
    *_, views = laid_out(tmp_path / "mixed.rrd", mixed)
    assert view in views
    *_, views = laid_out(tmp_path / "single.rrd", flight("s1"))
    assert view not in views


def test_the_layout_is_sent_again_only_once_however_many_flights_come(tmp_path: Path) -> None:
    flights = [flight("s1", t_s=t, samples=50) for t in range(0, 3 * int(COMPARED_S), 15)]
    sent = laid_out(tmp_path / "run.rrd", *flights)
    # For a study, for flights that began a while ago, and no more.
    assert len(sent) <= 3
