"""What is drawn, as numbers and as the viewer itself shows it."""

from __future__ import annotations

import os
import subprocess
from dataclasses import replace
from pathlib import Path

import matplotlib.image
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from rerun.experimental import ViewerClient
from study_events import iteration_event, samples_event, state_event
from tracking_events import flight

from nufleet.orchestrator.viewer.draw.axes import (
    HEIGHT,
    WIDTH,
    Axes,
    fitting_axes,
    round_up,
    spread,
)
from nufleet.orchestrator.viewer.draw.differences import around
from nufleet.orchestrator.viewer.draw.estimates import ranking_table
from nufleet.orchestrator.viewer.draw.marks import drawable
from nufleet.orchestrator.viewer.draw.outline import outline
from nufleet.orchestrator.viewer.draw.palette import TARGET, Palette
from nufleet.orchestrator.viewer.draw.telling import responses_at, telling_tone
from nufleet.orchestrator.viewer.events import LEADERS, MessageEvent, TakenBackEvent
from nufleet.orchestrator.viewer.server.open import open_native
from nufleet.orchestrator.viewer.server.picture import screenshot
from nufleet.orchestrator.viewer.server.rerun_program import rerun_environment, rerun_program
from nufleet.orchestrator.viewer.writer import RerunWriter
from nufleet.shared.distance.chordal import chordal_distance
from nufleet.shared.errors import InvalidInputError, NufleetError

EVERY_GLYPH = "".join(c for c in map(chr, range(0x20, 0x3000)) if drawable(c) == c)


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("runs") / "run.rrd"
    with RerunWriter("run-1", recording=path, serve=None) as writer:
        writer.emit(MessageEvent(0.0, "info", "\U0001f916 " + EVERY_GLYPH))
        writer.emit(state_event("s1", 0.0))
        writer.emit(samples_event("s1"))
        writer.emit(samples_event("target"))
        writer.emit(iteration_event())
    return path


def test_the_viewer_draws_every_view_and_every_glyph(recording: Path, tmp_path: Path) -> None:
    png = tmp_path / "run.png"
    assert screenshot(recording, png, size=(1200, 700)) == ()
    picture = matplotlib.image.imread(png)[:, :, :3]
    assert picture.shape == (700, 1200, 3)
    palette = Palette()
    palette.assign("target", ("s1", "s2", "s3"))
    for robot in ("target", "s1", "s2", "s3"):
        nearness = np.abs(picture - np.array(palette.of(robot)) / 255).max(axis=2)
        assert np.count_nonzero(nearness < 0.03) > 100, robot


@pytest.mark.parametrize("axes", [("x", "y"), ("x",)])
def test_the_viewer_draws_every_view_of_flights(tmp_path: Path, axes: tuple[str, ...]) -> None:
    path, png = tmp_path / "run.rrd", tmp_path / "run.png"
    priors = ("baseline", "none", "s1", "s2")
    with RerunWriter("run-1", recording=path, serve=None) as writer:
        for k, prior in enumerate(priors):
            writer.emit(flight(prior, t_s=15.0 * k, late_s=0.05 * (k + 1), axes=axes))
        writer.emit(TakenBackEvent(50.0, "target", "s2 · circle · 0.6 m/s", "it was worse"))
    assert screenshot(path, png, size=(1200, 700)) == ()
    picture = matplotlib.image.imread(png)[:, :, :3]
    palette = Palette()
    for prior in priors:
        nearness = np.abs(picture - np.array(palette.of_prior(prior)) / 255).max(axis=2)
        assert np.count_nonzero(nearness < 0.03) > 100, prior


def test_a_picture_that_a_busy_machine_does_not_draw_in_time_is_asked_for_again(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    take = ViewerClient.take_screenshot

    def late(viewer: ViewerClient) -> bytes:
        asked.append(viewer)
        if len(asked) == 1:
            raise TimeoutError("Deadline expired before operation could complete")
        return take(viewer)

    monkeypatch.setattr(ViewerClient, "take_screenshot", late)
    screenshot(recording, tmp_path / "run.png", size=(600, 400))
    assert (tmp_path / "run.png").exists()
    assert len(asked) > 2


def test_without_a_graphics_driver_the_package_to_install_is_named(
    recording: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for variable in ("VK_DRIVER_FILES", "VK_ICD_FILENAMES", "LIBGL_DRIVERS_PATH"):
        monkeypatch.setenv(variable, str(tmp_path / "none"))
    with pytest.raises(NufleetError, match="mesa-vulkan-drivers"):
        screenshot(recording, tmp_path / "run.png")


def test_a_file_that_is_no_recording_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "notes.txt"
    path.write_text("hello")
    with pytest.raises(InvalidInputError, match="not a Rerun recording"):
        screenshot(path, tmp_path / "run.png")
    with pytest.raises(InvalidInputError, match="No such file"):
        screenshot(tmp_path / "missing.rrd", tmp_path / "run.png")


def test_a_window_needs_a_display(recording: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for variable in ("DISPLAY", "WAYLAND_DISPLAY", "WAYLAND_SOCKET"):
        monkeypatch.delenv(variable, raising=False)
    with pytest.raises(NufleetError, match="no display"):
        open_native(recording)


def test_the_viewer_is_started_with_its_usage_statistics_off(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("FORCE_RERUN_ANALYTICS", "1")
    viewer = subprocess.run(
        [rerun_program(), "--version"],
        env={**rerun_environment(), "RUST_LOG": "debug"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert "Analytics disabled" in viewer.stdout + viewer.stderr
    assert os.environ["FORCE_RERUN_ANALYTICS"] == "1"


@given(
    st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=400),
    st.integers(1, 40).map(lambda half: 2 * half),
)
def test_an_outline_keeps_the_extremes_in_a_bounded_number_of_points(
    samples: list[float], points_max: int
) -> None:
    values = np.array(samples)
    kept = outline(values, points_max)
    assert len(kept) <= max(points_max, 1)
    assert np.all(np.diff(kept) > 0)
    assert values[kept].max() == values.max()
    assert values[kept].min() == values.min()


@given(st.floats(1e-9, 1e9))
def test_rounding_up_gives_the_next_of_1_2_5(value: float) -> None:
    rounded = round_up(value)
    assert value * (1 - 1e-8) <= rounded <= 2.5 * value * (1 + 1e-8)
    mantissa = rounded / 10 ** np.floor(np.log10(rounded) + 1e-9)
    assert min(abs(mantissa - m) for m in (1, 2, 5)) < 1e-6


@given(st.lists(st.floats(0, 100), min_size=1, max_size=6))
def test_labels_keep_their_order_and_do_not_cover_one_another(heights: list[float]) -> None:
    places = spread(np.array(heights), gap=8.0, within=100.0)
    order = np.argsort(heights, kind="stable")
    assert np.all(np.diff(places[order]) >= 8.0 - 1e-9)
    assert places.max() <= 100.0


def test_axes_span_the_curves_and_their_ticks_lie_within() -> None:
    axes = fitting_axes(iteration_event().curves)
    assert (axes.omega_min_rad_s, axes.omega_max_rad_s) == pytest.approx((0.1, 10.0))
    assert axes.omega_ticks_rad_s() == pytest.approx([0.1, 0.2, 0.5, 1, 2, 5, 10])
    assert 0.06 < axes.psi_max <= 1.0
    ticks = axes.psi_ticks()
    assert ticks[0] == 0.0
    assert 3 <= len(ticks) <= 6
    assert ticks[-1] <= axes.psi_max * (1 + 1e-9)
    assert axes.y(np.array([0.0, axes.psi_max])) == pytest.approx([HEIGHT, 0.0])


def test_the_frequency_axis_is_logarithmic() -> None:
    axes = Axes(0.1, 10.0, 0.1)
    assert axes.x(np.array([0.1, 1.0, 10.0])) == pytest.approx([0.0, WIDTH / 2, WIDTH])


@given(
    st.complex_numbers(min_magnitude=0.01, max_magnitude=10.0, allow_nan=False),
    st.lists(st.complex_numbers(max_magnitude=10.0, allow_nan=False), min_size=1, max_size=5),
)
def test_sources_stand_around_the_target_at_their_chordal_distances(
    target: complex, sources: list[complex]
) -> None:
    z = np.array(sources)
    places = around(target, z)
    distances = np.hypot(places[:, 0], places[:, 1])
    opposite = np.abs(z + 1 / np.conj(target)) < 1e-3  # has no direction
    np.testing.assert_allclose(
        distances[~opposite], chordal_distance(z, np.array(target))[~opposite], atol=1e-9
    )


def test_more_gain_is_up_and_more_lag_is_left() -> None:
    target = 0.6 * np.exp(-0.8j)
    places = around(complex(target), target * np.array([1.05, 0.95, np.exp(-0.05j)]))
    assert places[0][1] < 0
    assert places[0][0] == pytest.approx(0.0, abs=1e-4)
    assert places[1][1] > 0
    assert places[2][0] < 0


def test_every_leading_source_has_a_colour_of_its_own_and_keeps_it() -> None:
    palette = Palette()
    palette.assign("target", ("a", "b", "c"))
    first = {robot: palette.of(robot) for robot in ("target", "a", "b", "c")}
    palette.assign("target", ("d", "c", "e", "f", "g"))
    assert {robot: palette.of(robot) for robot in first} == first
    colours = [palette.of(robot) for robot in ("target", "a", "b", "c", "d", "e", "f", "g")]
    assert len(set(colours)) == 8
    assert palette.of("target") == TARGET
    assert palette.of("nobody") == palette.of("nobody else")


def test_of_a_large_fleet_the_best_are_drawn_in_full() -> None:
    event = iteration_event(sources=tuple(f"r{k:02d}" for k in range(32)))
    assert event.leaders == tuple(f"r{k:02d}" for k in range(LEADERS))


def test_the_most_telling_tone_is_where_the_sources_differ_most() -> None:
    event = iteration_event()
    tones = {robot: {1.0: 0.9 + 0j, **z, 3.0: 0.5 + 0j} for robot, z in event.responses.items()}
    several = replace(event, omega_rad_s=(1.0, 2.0, 3.0), responses=tones)
    assert telling_tone(several.answers) == 2.0


def test_a_tone_that_more_of_the_best_sources_know_is_more_telling_than_a_wider_gap() -> None:
    event = iteration_event()
    tones = {robot: {**z, 5.0: 0.7 - 0.2j} for robot, z in event.responses.items()}
    tones["s3"] = {9.0: -1 + 0j, **tones["s3"]}
    tones["target"] = {9.0: 0.1 + 0j, **tones["target"]}
    for robot in ("s1", "s2"):
        del tones[robot][2.0]
    several = replace(event, omega_rad_s=(2.0, 5.0, 9.0), responses=tones)
    assert telling_tone(several.answers) == 5.0
    assert set(responses_at(several.answers, 5.0)) == {"target", "s1", "s2", "s3"}


def test_sources_that_share_none_of_the_latest_tones_are_compared_at_earlier_ones() -> None:
    event = iteration_event()
    alone = {**event.responses, "target": {**event.responses["target"], 7.0: 0.2 + 0j}}
    assert telling_tone(replace(event, omega_rad_s=(7.0,), responses=alone).answers) == 2.0


def test_while_nothing_can_be_compared_the_lowest_tone_is_shown() -> None:
    event = iteration_event()
    alone = {"target": {3.0: 0.5 + 0j, 7.0: 0.2 + 0j}}
    assert telling_tone(replace(event, omega_rad_s=(3.0, 7.0), responses=alone).answers) == 3.0
    assert telling_tone(replace(event, omega_rad_s=(), responses={}).answers) == 0.0


def test_the_ranking_is_a_table_best_first() -> None:
    lines = ranking_table(iteration_event()).splitlines()
    assert lines[0] == "**Iteration 1**, tested at ω = 2 rad/s, target **target**"
    assert lines[-3:] == [
        "| 1 | **s1** | **0.0200** | 0.0160 to 0.0260 | 4 |  | 1 |",
        "| 2 | s2 | 0.0400 | 0.0320 to 0.0520 | 4 |  | 1 |",
        "| 3 | s3 | 0.0600 | 0.0480 to 0.0780 | 4 |  | 1 |",
    ]


def test_what_the_font_lacks_is_replaced() -> None:
    assert drawable("ψ ± 1σ ≤ 0.2 — \U0001f916 █") == "ψ ± 1σ ≤ 0.2 — ? ?"
