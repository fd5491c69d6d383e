"""`nufleet rank` and `nufleet demo` as a user and as another program run them."""

from __future__ import annotations

import json
import os
import re
import signal
import socket
import sqlite3
import subprocess
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from child_processes import children_of
from command_processes import NUFLEET, PATIENCE_S, Typed, nufleet, trial_statuses
from lifeline import started_with
from page_story import Story
from polling import wait_until

from nufleet.orchestrator.experience import training
from nufleet.orchestrator.fleet import connection
from nufleet.shared.wire.transport import open_client, open_router

ROOT = Path(__file__).parents[2]
FLEET = ROOT / "sims" / "fleets" / "paper_linear.toml"
PLAIN = ("--no-rehearsal", "--no-recording")


@dataclass(frozen=True)
class Ranked:
    """A ranking that has ended: the folder where it was run, what it printed, and what it said."""

    folder: Path
    document: dict[str, Any]
    said: str

    @property
    def run(self) -> Path:
        return self.folder / str(self.document["run"])


def ranked(folder: Path, command: str, *options: str) -> Ranked:
    """Type a command of a page, with further options."""
    with Story(folder) as story:
        printed = story.nufleet(*command.split()[1:], *options, "--json")
    return Ranked(folder, json.loads(printed.out), printed.shown)


@pytest.fixture(scope="module")
def paper(tmp_path_factory: pytest.TempPathFactory) -> Ranked:
    """The paper's ranking, rehearsed and recorded."""
    folder = tmp_path_factory.mktemp("paper")
    return ranked(folder, "nufleet rank --fleet paper_linear --algorithm paper")


@pytest.fixture(scope="module")
def first_page(tmp_path_factory: pytest.TempPathFactory) -> Ranked:
    """What a reader of the first page has seen and got."""
    folder = tmp_path_factory.mktemp("first-page")
    with Story(folder) as story:
        shown = story.follow("docs/index.md")
    (results,) = folder.glob("runs/*/results.json")
    return Ranked(folder, json.loads(results.read_text())["result"], shown)


def test_no_robot_moves_further_than_was_asked_for_however_little_noise_lets_through(
    tmp_path: Path,
) -> None:
    noisy = tmp_path / "noisy.toml"
    text = FLEET.read_text(encoding="utf-8")
    noisy.write_text(text.replace("beta", "noise_std_m = 0.003, beta"), encoding="utf-8")
    command = f"nufleet rank --fleet {noisy.name} --amplitude 0.02"
    found = ranked(tmp_path, command, *PLAIN, "--iterations", "3")
    announced = [float(one) for one in re.findall(r"within ±([0-9.]+) m", found.said)]
    assert len(announced) > 1
    assert max(announced) <= 0.02
    with closing(sqlite3.connect(tmp_path / "runs" / "nufleet.sqlite")) as connection:
        played = [one for (one,) in connection.execute("SELECT amplitude FROM responses")]
    assert len(played) > 4
    assert max(played) <= 0.02


def test_rank_prints_the_documented_json_alone_on_stdout(paper: Ranked) -> None:
    document = paper.document
    assert list(document) == [
        *("schema", "target", "band_rad_s", "selected", "ranking", "iterations", "robot_time_s"),
        *("run", "verdicts", "findings", "ways_path", "ways_unit", "ways", "chosen_way"),
    ]
    assert document["schema"] == 1
    assert document["target"] == "target"
    assert document["band_rad_s"] == [0.05, 10.0]
    assert document["selected"] == "source-2"
    assert document["iterations"] == 7
    assert [row["robot"] for row in document["ranking"]] == ["source-2", "source-1", "source-3"]
    for row, closed_form in zip(document["ranking"], (0.0212, 0.0694, 0.0918), strict=True):
        assert set(row) == {
            *("robot", "psi", "psi_low", "psi_high", "omega_rad_s", "tests"),
            *("measured_psi", "measured_omega_rad_s"),
        }
        assert row["psi"] == pytest.approx(closed_form, rel=0.01)
        assert row["tests"] == 7
    assert document["robot_time_s"] > 0
    for found in document["verdicts"].values():
        # All four loops differ little, and none follows the upper band by itself.
        assert found["verdict"] == "transfer"
        assert found["error_with"]["high"] < found["error_without"]["low"]
        assert len(found["gain_with"]["median"]) == len(found["omega_rad_s"])
    ways = {(way["way"], way["own_flight_s"]): way for way in document["ways"]}
    assert {way for way, _ in ways} == {
        "baseline",
        "none",
        "own",
        "source-1",
        "source-2",
        "source-3",
    }
    for (way, _), found in ways.items():
        assert list(found) == [
            *("way", "own_flight_s", "predicted_rms_m", "predicted_low_m", "predicted_high_m"),
            *("rms_m", "reduction_percent", "taken_back", "unseen", "reason"),
        ]
        if way.startswith("source"):
            assert found["predicted_rms_m"] is None
            assert found["reason"] == f"it has learned nothing yet: `nufleet train --robot {way}`"
        else:
            assert found["predicted_low_m"] <= found["predicted_rms_m"] <= found["predicted_high_m"]
    # The simulated loop is linear, and its sensor has no noise.
    assert document["chosen_way"] == "own"


def test_rank_for_a_trajectory_names_what_leaves_the_smallest_error_on_it(tmp_path: Path) -> None:
    circle = tmp_path / "circle.csv"
    angles = np.linspace(0, 2 * np.pi, 200)
    rows = (f"{np.cos(a)},{np.sin(a)}" for a in angles)
    circle.write_text("x_m,y_m\n" + "\n".join(rows) + "\n")
    arguments = ("rank", "--fleet", str(FLEET), "--trajectory", str(circle), "--speed", "0.5")
    arguments = (*arguments, *PLAIN)
    for algorithm in ("paper", "adaptive"):
        done = nufleet(*arguments, "--algorithm", algorithm, "--json", cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        document = json.loads(done.stdout)
        assert document["trajectory"] == "circle at 0.5 m/s"
        errors = [
            document["verdicts"][row["robot"]]["error_with"]["median"]
            for row in document["ranking"]
        ]
        # What is most surely good, within 0.01, leads where an algorithm knows how sure it is.
        assert errors[0] <= min(errors) + 0.01
        others = errors if algorithm == "paper" else errors[1:]
        assert others == sorted(others)
        assert document["selected"] == document["ranking"][0]["robot"]
        assert "transfer to target, on circle at 0.5 m/s" in done.stderr
        report = (tmp_path / document["run"] / "report.md").read_text(encoding="utf-8")
        assert "Transfer to target, on circle at 0.5 m/s" in report


def test_rank_says_how_sure_it_is_who_was_out_early_and_why_it_stopped(
    typed: Typed, first_page: Ranked, paper: Ranked
) -> None:
    adaptive, document = first_page, first_page.document
    assert document["selected"] == "source-2"
    assert document["confidence"] >= 0.95
    assert set(document["eliminated"]) <= {"source-1", "source-3"}
    assert document["stopped_because"].startswith("source-2 is the closest")
    assert set(document["verdicts"]) == {"source-1", "source-2", "source-3"}
    assert document["stopped_because"] in adaptive.said
    report = (adaptive.run / "report.md").read_text(encoding="utf-8")
    assert f"Probability of a correct selection: {document['confidence']:.3f}: source-2" in report
    assert all(f"- {source}: " in report for source in document["eliminated"])
    assert "confidence" not in paper.document
    assert document["robot_time_s"] < paper.document["robot_time_s"] / 4
    reuse = ("--fleet", str(FLEET), "--algorithm", "paper", "--reuse")
    refused = typed("rank", *reuse, cwd=adaptive.folder)
    assert refused.returncode == 2
    assert "--reuse requires --algorithm adaptive" in refused.stderr
    again = ranked(adaptive.folder, "nufleet rank --fleet paper_linear", *PLAIN, "--reuse")
    reusing = again.document
    assert list(reusing) == [
        *("schema", "target", "band_rad_s", "selected", "ranking", "iterations", "robot_time_s"),
        *("run", "confidence", "eliminated", "stopped_because", "verdicts", "findings"),
        *("stored", "ways"),
    ]
    drawn = {"plots", "run.rrd"}
    assert not drawn & {path.name for path in again.run.iterdir()}
    report = (again.run / "report.md").read_text(encoding="utf-8")
    assert not [name for name in drawn if name in report]
    assert set(reusing["stored"]) == {"source-1", "source-2", "source-3"}
    assert "source-2 needed no first test" in again.said
    assert reusing["selected"] == "source-2"
    assert reusing["robot_time_s"] < document["robot_time_s"]


def test_a_run_leaves_a_folder_that_runs_list_and_runs_show_read(
    typed: Typed, paper: Ranked
) -> None:
    run = paper.run
    assert {path.name for path in run.iterdir()} == {
        *("config.json", "results.json", "telemetry.parquet", "run.rrd", "plots", "report.md"),
        *("report.html", "ranking.csv", "headline.json"),
    }
    assert {path.suffix for path in (run / "plots").iterdir()} == {".png"}
    listed = json.loads(typed("runs", "list", "--json", cwd=paper.folder).stdout)
    assert [Path(entry["run"]).name for entry in listed["runs"]] == [run.name]
    shown = json.loads(typed("runs", "show", "latest", "--json", cwd=paper.folder).stdout)
    assert shown["result"] == paper.document
    assert len(shown["history"]) == 7


def test_the_demo_prints_what_the_readme_shows_and_prevents_the_harm_that_it_predicts(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # `make demo` does not install torch.
    monkeypatch.setattr(training, "find_spec", lambda name: None)
    with Story(tmp_path) as story:
        shown = story.follow("README.md")
    (run,) = tmp_path.glob("runs/*-demo")
    document = json.loads((run / "demo.json").read_text())
    flights, unguarded = document["flights"], document["unguarded"]
    closest, furthest = flights["sources"]
    assert [closest["robot"], furthest["robot"]] == ["source-2", "source-4"]
    baseline = flights["baseline"]["rms_m"]
    assert closest["rms_m"] < baseline
    assert closest["reduction_percent"] == pytest.approx(100 * (1 - closest["rms_m"] / baseline))
    # The harm was predicted, the guard prevented it, and without the guard it is there.
    assert document["ranking"]["verdicts"]["source-4"]["verdict"] == "do not transfer"
    assert furthest["predicted_rms_m"] > 1.5 * baseline
    assert furthest["taken_back"] == 1
    assert furthest["rms_m"] < baseline < unguarded["rms_m"] < furthest["predicted_rms_m"]
    assert {"results.json", "flights.parquet", "run.rrd", "experiences"} <= {
        path.name for path in run.iterdir()
    }
    assert " view " in shown


def has_begun(pid: int) -> bool:
    """Whether `nufleet` itself runs, and not yet Python's start: it has a handler for SIGTERM."""
    status = Path(f"/proc/{pid}/status").read_text()
    (caught,) = (line.split()[1] for line in status.splitlines() if line.startswith("SigCgt"))
    return bool(int(caught, 16) >> (signal.SIGTERM - 1) & 1)


MOMENTS: dict[str, Callable[[int, Path], bool]] = {
    "as it begins": lambda pid, database: has_begun(pid),
    "as it starts its robots": lambda pid, database: len(children_of(pid)) > 1,
    "while they move": lambda pid, database: "accepted" in trial_statuses(database),
}


@pytest.mark.parametrize("moment", MOMENTS)
def test_ctrl_c_at_any_moment_leaves_no_process_behind(tmp_path: Path, moment: str) -> None:
    state = str(tmp_path / "its own")  # by which the processes that it starts are found
    ranking = subprocess.Popen(
        [*NUFLEET, "rank", "--fleet", str(FLEET), "--realtime", "1", "--no-recording"],
        cwd=tmp_path,
        env={**os.environ, "NUFLEET_STATE": state},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    database = tmp_path / "runs" / "nufleet.sqlite"
    wait_until(lambda: MOMENTS[moment](ranking.pid, database))
    ranking.send_signal(signal.SIGINT)
    _, said = ranking.communicate(timeout=PATIENCE_S)
    # A shell shows 130 for both: CPython ends by the signal itself, after an orderly exit, when the
    # interrupt came while a module was being imported.
    assert ranking.returncode in (130, -signal.SIGINT), said
    assert "Traceback" not in said
    assert ("all 4 robots are at rest" in said) == bool(trial_statuses(database))
    assert not started_with("NUFLEET_STATE", state)


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["--target", "nobody"], 2, "no robot 'nobody'"),
        (["--sources", "source-1,nobody"], 2, "no robot 'nobody'"),
        (["--sources", "target,source-1"], 2, "among the sources"),
        (["--band", "10", "0.1"], 2, "reversed"),
        (["--band", "1", "1"], 2, "empty"),
        (["--band", "0", "10"], 2, "period is infinite"),
        (["--band", "0.05", "90"], 2, "exceeds the range in which robot target can be tested"),
        (["--axis", "yaw"], 2, "no axis 'yaw'; it has x"),
        (["--axis", "x", "--axes", "x,y"], 2, "give either --axis or --axes"),
        (["--axes", "x,y", "--algorithm", "paper"], 2, "--axes requires --algorithm adaptive"),
        (["--iterations", "0"], 2, "--iterations"),
        (["--trajectory", "no-such-drawing"], 2, "no such drawing"),
        (["--speed", "0.5"], 2, "--speed requires --trajectory"),
        (["--trajectory", "clover", "--speed", "60"], 2, "choose a speed of at most 1 m/s"),
    ],
)
def test_a_request_that_cannot_be_right_is_refused_with_the_reason(
    typed: Typed, tmp_path: Path, arguments: list[str], code: int, words: str
) -> None:
    done = typed("rank", "--fleet", str(FLEET), *arguments, "--json", cwd=tmp_path)
    assert done.returncode == code
    assert done.stdout == ""
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert not list(tmp_path.glob("runs/*/telemetry.parquet"))


def test_a_typo_in_a_fleet_file_names_file_field_and_expectation(
    typed: Typed, tmp_path: Path
) -> None:
    fleet = tmp_path / "typo.toml"
    fleet.write_text(FLEET.read_text().replace("alpha = 0.85", 'alpha = "big"'))
    done = typed("rank", "--fleet", str(fleet), cwd=tmp_path)
    assert done.returncode == 2
    assert "typo.toml" in done.stderr
    assert "robots.target.settings" in done.stderr
    assert "alpha" in done.stderr
    assert "number" in done.stderr


def test_no_router_is_an_error_that_says_how_to_start_one(
    typed: Typed, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(connection, "CONNECT_TIMEOUT_S", 0.2)
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        endpoint = f"tcp/127.0.0.1:{free.getsockname()[1]}"
        done = typed("rank", "--connect", endpoint, "--target", "target", cwd=tmp_path)
    assert done.returncode == 1
    assert endpoint in done.stderr
    assert "nufleet router" in done.stderr


def test_a_robot_that_never_answers_is_an_error_that_names_it_before_anything_moves(
    typed: Typed, tmp_path: Path
) -> None:
    endpoint = f"unixsock-stream/{tmp_path}/r.sock"
    with open_router([endpoint]), open_client(endpoint, timeout_s=PATIENCE_S) as mute:
        for robot in ("target", "source-1"):
            mute.declare_alive(f"nufleet/lab/robot/{robot}/alive")
        done = typed("rank", "--connect", endpoint, "--target", "target", cwd=tmp_path)
    assert done.returncode == 1
    assert "robot target does not answer" in done.stderr
    assert "nufleet fleet status" in done.stderr
    assert not list(tmp_path.glob("runs/*/"))


def test_a_port_in_use_is_an_error_that_names_it(tmp_path: Path) -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        for command in (
            ["router", "--listen", endpoint],
            ["fleet", "up", str(FLEET), "--listen", endpoint],
        ):
            done = nufleet(*command, cwd=tmp_path)
            assert done.returncode == 1
            assert f"cannot listen on {endpoint}: Address already in use. Is a" in done.stderr


def test_a_runs_folder_that_cannot_be_written_is_refused_before_anything_starts(
    typed: Typed, tmp_path: Path
) -> None:
    blocked = tmp_path / "runs"
    blocked.write_text("a file where the folder should be")
    done = typed("rank", "--fleet", str(FLEET), cwd=tmp_path)
    assert done.returncode == 2
    assert "runs" in done.stderr
    assert "iteration 1" not in done.stderr


def test_help_is_there_for_every_command(typed: Typed, tmp_path: Path) -> None:
    top = typed("--help", cwd=tmp_path)
    assert top.returncode == 0
    commands = ("demo", "rank", "train", "transfer", "track", "evaluate", "router", "agent", "view")
    for command in (*commands, "runs", "fleet", "stop", "doctor"):
        assert command in top.stdout
        shown = typed(command, "--help", cwd=tmp_path)
        assert shown.returncode == 0
        assert "Usage: nufleet" in shown.stdout


def test_doctor_finds_everything_that_the_demo_needs(tmp_path: Path) -> None:
    done = nufleet("doctor", "--json", cwd=tmp_path)
    checks = {check["what"]: check for check in json.loads(done.stdout)["checks"]}
    assert done.returncode == 0, checks
    assert checks["zenoh"]["verdict"] == "ok"
    assert "double_integrator" in checks["robot drivers"]["found"]


def test_a_running_fleet_is_shown_ranked_stopped_and_released(
    tmp_path: Path, endpoint: str
) -> None:
    state = str(tmp_path / "its own")  # by which the processes that it starts are found
    up = subprocess.Popen(
        [*NUFLEET, "fleet", "up", str(FLEET), "--listen", endpoint, "--processes"],
        cwd=tmp_path,
        env={**os.environ, "NUFLEET_STATE": state},
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert up.stderr is not None
    try:
        assert "4 robots of fleet paper-linear are up" in up.stderr.readline()
        assert len(children_of(up.pid)) == 5
        join = ("--connect", endpoint)
        status = json.loads(nufleet("fleet", "status", *join, "--json", cwd=tmp_path).stdout)
        assert {state["status"] for state in status["robots"].values()} == {"idle"}
        printed = up.stderr.readline().partition("nufleet ")[2].split()
        assert printed == ["rank", "--target", "target", "--band", "0.05", "10", *join]
        ranked = nufleet(*printed, "--iterations", "3", *PLAIN, "--json", cwd=tmp_path)
        assert json.loads(ranked.stdout)["selected"] == "source-2"
        assert nufleet("stop", "source-2", *join, cwd=tmp_path).returncode == 0
        without = nufleet(
            *("rank", *join, "--target", "target", "--band", "0.5", "10"),
            *("--iterations", "3", *PLAIN, "--json"),
            cwd=tmp_path,
        )
        assert [r["robot"] for r in json.loads(without.stdout)["ranking"]] == [
            "source-1",
            "source-3",
        ]
        assert "continuing without source-2" in without.stderr
        assert "source-2 was left out" in without.stderr
        assert "release it first with `nufleet release`" in without.stderr
        assert nufleet("release", "source-2", *join, cwd=tmp_path).returncode == 0
        assert nufleet("stop", "nobody", *join, cwd=tmp_path).returncode == 1
    finally:
        up.send_signal(signal.SIGINT)
        up.communicate(timeout=PATIENCE_S)
    assert up.returncode == 130
    assert not started_with("NUFLEET_STATE", state)
