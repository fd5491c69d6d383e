"""`nufleet train`, `transfer` and `track` as a user runs them, with a fleet that is up."""

from __future__ import annotations

import hashlib
import json
import signal
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import psutil
import pyarrow.compute as pc
import pyarrow.parquet as pq
import pytest
from command_processes import Typed, begun, fleet_that_is_up
from learned_things import experience, layout
from page_story import Story
from polling import PATIENCE_S, wait_until

from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.jobs import train
from nufleet.orchestrator.repository.address import default_url
from nufleet.orchestrator.repository.records import Origin
from nufleet.orchestrator.repository.repository import open_repository
from nufleet.orchestrator.runs.rank_result import RankResult
from nufleet.orchestrator.runs.verdict_table import verdict_parts
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.file import decode_experience
from nufleet.shared.wire.keys import FleetKeys
from nufleet.shared.wire.messages import Description, RobotStatus
from nufleet.shared.wire.transport import open_client

SLOWER = """
schema = 1
name = "paper-linear"

[robots.slower]
driver = "double_integrator"
settings = { alpha = 0.97, beta = 0.004, sample_time_s = 0.02 }
"""

SLOW = """
schema = 1
name = "slow"

[robots.target]
driver = "double_integrator"
settings = { alpha = 0.85, beta = 0.003 }
"""

CIRCLE = [(np.cos(a), np.sin(a)) for a in np.linspace(0, 2 * np.pi, 200)]


def drawing(folder: Path, name: str = "circle.csv", points: object = CIRCLE) -> Path:
    path = folder / name
    path.write_text("x_m,y_m\n" + "\n".join(f"{x},{y}" for x, y in np.asarray(points)) + "\n")
    return path


@dataclass(frozen=True)
class Workplace:
    """A fleet that is up, and the folder where commands are run."""

    story: Story
    name: str

    @property
    def folder(self) -> Path:
        return self.story.folder

    @property
    def endpoint(self) -> str:
        return self.story.endpoint

    def json(self, *words: str) -> dict[str, object]:
        """What a command that succeeds prints on stdout, which is one document alone."""
        document = json.loads(self.story.nufleet(*words, "--json").out)
        assert isinstance(document, dict)
        return document

    def left(self, file: str) -> dict[str, object]:
        """The document that the only run which leaves such a file has left."""
        (path,) = self.folder.glob(f"runs/{file}")
        document = json.loads(path.read_text())
        assert isinstance(document, dict)
        return document

    def describe(self, robot: str = "target") -> Description:
        with open_client(self.endpoint, timeout_s=PATIENCE_S) as session:
            return Fleet(session, FleetKeys(self.name), "tester").describe(robot)

    def runs(self) -> set[Path]:
        return set((self.folder / "runs").glob("*/"))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workplace]:
    """The fleet of a reader who did all that the guide tells, and another robot that joined it."""
    with Story(tmp_path_factory.mktemp("lab")) as story:
        story.follow("docs/guide.md")
        (story.folder / "slower.toml").write_text(SLOWER)
        story.type("nufleet agent slower.toml")
        yield Workplace(story, "paper-linear")


@pytest.fixture(scope="module")
def training(lab: Workplace) -> dict[str, object]:
    """One robot has learned; the document that said so."""
    return lab.left("*-train/train.json")


@pytest.fixture(scope="module")
def tracked(lab: Workplace) -> dict[str, object]:
    """The target has flown with what that robot has learned; the document that said so."""
    (first, *_) = sorted(lab.folder.glob("runs/*-track/track.json"))
    document = json.loads(first.read_text())
    assert isinstance(document, dict)
    return document


@pytest.fixture
def transferred(lab: Workplace, training: dict[str, object]) -> dict[str, object]:
    words = ("--target", "target", "--source", "source-2", "--no-rehearsal")
    return lab.json("transfer", *words)


# Learning, and handing over.


def test_training_leaves_an_experience_on_the_robot_and_in_the_run(
    lab: Workplace, training: dict[str, object]
) -> None:
    (one,) = training["experiences"]  # type: ignore[misc]
    assert set(one) == {"robot", "sha256", "training_time_s", "horizon_trials", "manifest"}
    offers = lab.describe("source-2").experiences
    assert [offer.sha256 for offer in offers] == [one["sha256"]]
    file = lab.folder / str(training["run"]) / "experiences" / "source-2-preview.safetensors"
    payload = file.read_bytes()
    assert hashlib.sha256(payload).hexdigest() == one["sha256"]
    manifest = decode_experience(payload).manifest
    assert one["manifest"] == manifest.model_dump(mode="json")
    assert (manifest.robot, manifest.points) == ("source-2", 2100)
    flown = [t["rms_error"] for t in one["horizon_trials"] if t["rms_error"] is not None]
    chosen = manifest.layout.horizon_samples
    (mine,) = (t for t in one["horizon_trials"] if t["horizon_samples"] == chosen)
    assert mine["rms_error"] <= 1.05 * min(flown)
    # No robot flies with a prior that was only tried.
    assert lab.describe("source-2").prior is None


def assert_the_trained_source_was_rehearsed(ranked: dict[str, object]) -> None:
    """Fail unless a ranking says what its only trained source would leave, and which way to fly."""
    ways = {way["way"]: way for way in reversed(ranked["ways"])}  # type: ignore[call-overload]
    expected = {name: way["predicted_rms_m"] for name, way in ways.items()}
    sources = {"source-1", "source-2", "source-3"}
    assert set(expected) == {"baseline", "none", "own"} | sources
    assert expected["source-1"] is None
    assert "nufleet train --robot source-1" in ways["source-1"]["reason"]
    assert expected["source-2"] < expected["baseline"]
    assert ranked["chosen_way"] == min(
        (name for name, error in expected.items() if error is not None), key=expected.__getitem__
    )
    verdict = ranked["verdicts"]["source-2"]  # type: ignore[index]
    assert verdict["verdict"] == "transfer"
    assert "as rehearsed" in verdict["reason"]


def test_the_best_source_is_that_of_the_latest_ranking(
    typed: Typed, lab: Workplace, training: dict[str, object]
) -> None:
    nobody = ("--target", "slower", "--source", "best", "--connect", lab.endpoint)
    unknown = typed("transfer", *nobody, cwd=lab.folder)
    assert unknown.returncode == 2
    assert "nufleet rank --target slower" in unknown.stderr
    ranked = lab.left("*-paper-linear/results.json")["result"]
    assert isinstance(ranked, dict)
    assert ranked["selected"] == "source-2"
    assert_the_trained_source_was_rehearsed(ranked)
    *_, last = verdict_parts(RankResult.model_validate_json(json.dumps(ranked)))
    assert "source-2: it has learned and was rehearsed" in str(last)
    # The guide transferred from the best source.
    (one,) = training["experiences"]  # type: ignore[misc]
    prior = lab.describe().prior
    assert prior is not None
    assert prior.sha256 == one["sha256"]


def test_an_experience_is_handed_over_by_name_from_a_file_and_taken_away(
    typed: Typed, lab: Workplace, training: dict[str, object], transferred: dict[str, object]
) -> None:
    prior = lab.describe().prior
    assert prior is not None
    assert prior.sha256 == transferred["sha256"]
    there = ("--target", "target", "--connect", lab.endpoint, "--json")
    gone = typed("transfer", *there, "--source", "none", cwd=lab.folder)
    document = json.loads(gone.stdout)
    assert (document.pop("schema"), document.pop("target")) == (1, "target")
    assert document.pop("companions") == []
    assert set(document.values()) == {None}
    assert document.keys() >= {"source", "sha256", "taken_from"}
    assert lab.describe().prior is None
    file = f"{training['run']}/experiences/source-2-preview.safetensors"
    again = typed("transfer", *there, "--file", file, "--no-rehearsal", cwd=lab.folder)
    as_file = {"taken_from": "file", "reason": "it was given as a file", "learned_at": None}
    assert json.loads(again.stdout) == {**transferred, **as_file}
    prior = lab.describe().prior
    assert prior is not None
    assert prior.sha256 == transferred["sha256"]


# Tracking.


def test_a_track_says_and_stores_what_was_flown(lab: Workplace, tracked: dict[str, object]) -> None:
    run = lab.folder / str(tracked["run"])
    assert {path.name for path in run.iterdir()} == {
        *("config.json", "track.json", "flights.parquet", "run.rrd", "report.html"),
        "headline.json",
    }
    circle = str(drawing(lab.folder))
    at_once = ("--target", "target", "--no-rehearsal", "--inverse", "baseline")
    alone = lab.json("track", *at_once, "--trajectory", circle)
    assert lab.left(f"{Path(str(alone['run'])).name}/track.json") == alone
    flights: list[dict[str, object]] = tracked["flights"]  # type: ignore[assignment]
    baselines: list[dict[str, object]] = alone["flights"]  # type: ignore[assignment]
    assert [(f["inverse"], f["drawing"]) for f in flights + baselines] == [
        ("source-2", "clover"),
        ("baseline", "circle"),
    ]
    where = {"source-2": run, "baseline": lab.folder / str(alone["run"])}
    for flight in flights + baselines:
        rows = pq.read_table(where[str(flight["inverse"])] / "flights.parquet")
        label = f"{flight['inverse']} · {flight['drawing']} · 0.6 m/s"
        mine = rows.filter(pc.equal(pc.cast(rows["flight"], "string"), label))
        desired, actual = np.asarray(mine["desired"]), np.asarray(mine["actual"])
        assert len(desired) > 500
        rms_m = float(np.sqrt(np.mean((actual - desired) ** 2)))
        assert flight["rms_m"] == pytest.approx(rms_m)
        speeds = np.abs(np.diff(desired)) / 0.015
        assert speeds.max() == pytest.approx(0.6, rel=0.05)
        assert (flight["failure"], flight["taken_back"]) == (None, None)
    configured = json.loads((where["baseline"] / "config.json").read_text())
    assert configured["drawings"] == [circle]
    # The baseline's reference was fixed in advance, so that its flight is a measurement as well.
    with open_repository(default_url(lab.folder / "runs")) as repository:
        (measured,) = repository.flights.responses(lab.name, "target", "x")
    assert measured.origin is Origin.FLIGHT
    assert str(measured.study_id).startswith(Path(str(alone["run"])).name)


def test_a_robot_that_has_flown_inverts_its_own_loop_and_says_what_to_expect(
    lab: Workplace,
) -> None:
    """It has never been tested: what its guard has to know takes half a minute, and is said."""
    path = ("--target", "slower", "--trajectory", "clover", "--speed", "0.5")
    first = lab.story.nufleet("track", *path, "--inverse", "own", "--json")
    assert "slower flies for 30 s first" in first.shown
    (own,) = json.loads(first.out)["flights"]
    (baseline,) = lab.json("track", *path, "--inverse", "baseline")["flights"]  # type: ignore[misc]
    assert own["inverse"] == "own"
    assert own["own_flight_s"] >= 30.0
    assert own["rms_m"] < 0.05 * baseline["rms_m"]
    assert own["predicted_low_m"] <= own["predicted_rms_m"] <= own["predicted_high_m"]
    assert baseline["predicted_rms_m"] == pytest.approx(baseline["rms_m"], rel=0.05)
    more = lab.story.nufleet(
        "track", *path, "--inverse", "own", "--rich-flight", "15", "--no-rehearsal"
    )
    assert "slower flies for 15 s first" in more.shown


@pytest.fixture(scope="module")
def slow(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Workplace]:
    """A robot in real time."""
    folder = tmp_path_factory.mktemp("slow")
    file, story = folder / "slow.toml", Story(folder)
    file.write_text(SLOW)
    with fleet_that_is_up(file, story.endpoint, folder, "--realtime", "2"):
        yield Workplace(story, "slow")


@pytest.mark.parametrize(
    "arguments",
    [
        ("track", "--target", "target", "--trajectory", "clover", "--speed", "0.3"),
        ("train", "--robot", "target", "--duration", "60"),
    ],
    ids=lambda arguments: arguments[0],
)
def test_ctrl_c_in_flight_leaves_the_robot_at_rest_and_nobody_in_command(
    slow: Workplace, arguments: tuple[str, ...]
) -> None:
    with open_client(slow.endpoint, timeout_s=PATIENCE_S) as session:
        fleet = Fleet(session, FleetKeys("slow"), "tester")
        watch = fleet.watch("target")
        command = begun(arguments[0], "--connect", slow.endpoint, *arguments[1:], cwd=slow.folder)
        assert watch.wait_until(
            lambda w: w.state is not None and bool(w.state.goal_id) and w.state.progress > 0.02,
            timeout_s=PATIENCE_S,
        ), watch.state
        assert watch.state is not None
        flying = watch.state.goal_id
        assert flying is not None
        command.send_signal(signal.SIGINT)
        out, said = command.communicate(timeout=PATIENCE_S)
        assert (command.returncode, out) == (130, ""), said
        assert "Traceback" not in said
        at_rest = watch.wait_until(
            lambda w: w.state is not None and w.state.status is RobotStatus.IDLE,
            timeout_s=PATIENCE_S,
        )
        assert at_rest, watch.state
        assert watch.state.last_goal_id == flying
        assert fleet.result("target", flying).outcome == "cancelled"
        assert fleet.describe("target").prior is None
    wait_until(lambda: not psutil.pid_exists(command.pid))


# What is refused, before anything moves.


def refused(
    typed: Typed,
    lab: Workplace,
    command: str,
    *arguments: str,
    words: tuple[str, ...],
    robot: str = "target",
) -> None:
    """Run a command that has to be refused; nothing moves, nothing is left."""
    runs = lab.runs()
    with open_client(lab.endpoint, timeout_s=PATIENCE_S) as session:
        fleet = Fleet(session, FleetKeys(lab.name), "tester")
        watch = fleet.watch(robot)
        assert watch.wait_until(lambda w: w.state is not None, timeout_s=PATIENCE_S)
        before, learned = watch.state, fleet.describe(robot)
        there = ("--connect", lab.endpoint, "--json")
        done = typed(command, *there, *arguments, cwd=lab.folder)
        assert watch.state is not None
        assert before is not None
        assert watch.state.robot_time_s == before.robot_time_s
        assert watch.state.last_goal_id == before.last_goal_id
        assert fleet.describe(robot) == learned
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr
    assert lab.runs() == runs


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--scale", "3"), ("robot target", "outside the workspace", "--scale")),
        (("--speed", "2.5"), ("robot target", "choose a speed of at most 1 m/s")),
        (("--speed", "0.0001"), ("robot target", "choose a higher speed")),
        (("--inverse", "zero-prior", "--horizon", "60"), ("robot target", "at most 7.5 s")),
    ],
    ids=["large", "fast", "slow", "far-ahead"],
)
def test_a_path_that_the_robot_may_not_fly_is_refused(
    typed: Typed, lab: Workplace, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    refused(
        typed, lab, "track", "--target", "target", "--trajectory", "clover", *options, words=words
    )


def refused_at_once(
    typed: Typed, folder: Path, command: str, *arguments: str, words: tuple[str, ...]
) -> None:
    """Run a command that has to be refused without a router being there."""
    nowhere = f"unixsock-stream/{folder}/nobody.sock"
    done = typed(command, "--target", "target", "--connect", nowhere, *arguments, cwd=folder)
    assert done.returncode == 2, done.stderr
    assert done.stdout == ""
    assert "Traceback" not in done.stderr
    for word in words:
        assert word in done.stderr
    assert not (folder / "runs").exists()


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--speed", "nan"), ("--speed", "above 0")),
        (("--scale", "inf"), ("--scale", "finite")),
        (("--trajectory", "clover"), ("two drawings are called clover",)),
    ],
    ids=["nan", "inf", "twice"],
)
def test_numbers_and_names_that_cannot_be_right_are_refused_before_a_fleet_is_reached(
    typed: Typed, tmp_path: Path, options: tuple[str, ...], words: tuple[str, ...]
) -> None:
    refused_at_once(typed, tmp_path, "track", "--trajectory", "clover", *options, words=words)


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("nan.csv", "x_m,y_m\n0,0\nnan,1\n1,1\n", "nan"),
        ("one.csv", "x_m,y_m\n0.5,0.5\n", "two different points"),
        ("other.csv", "time,speed\n0,0\n1,1\n", "the first line must be x_m,y_m"),
        ("image.png", "\x89PNG", "a drawing must be a .csv or .svg file"),
    ],
)
def test_what_is_no_drawing_is_refused_before_a_fleet_is_reached(
    typed: Typed, tmp_path: Path, name: str, text: str, words: str
) -> None:
    file = tmp_path / name
    file.write_text(text)
    refused_at_once(typed, tmp_path, "track", "--trajectory", str(file), words=(name, words))


AMONG_ALIKE = ("evaluate", "--target", "target", "--sources", "source-1,source-2")


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((*AMONG_ALIKE, "--speeds", "0.3,5"), ("robot target", "at most 1 m/s")),
        (("evaluate", "--target", "slower", "--speeds", "5"), ("robot slower", "at most 1 m/s")),
        (("evaluate", "--all-pairs"), ("source-1 would not fit slower", "leave source-1 out")),
        ((*AMONG_ALIKE, "--speeds", "0.3,0.3"), ("named twice",)),
        (("evaluate", "--all-pairs", "--target", "target"), ("leave --target and --sources out",)),
        (("evaluate", "--target", "target", "--drawings", "cl0ver"), ("no such drawing", "clover")),
        (("evaluate", "--target", "target", "--sources", "nobody"), ("no robot 'nobody'",)),
        (("train", "--robot", "nobody"), ("no robot 'nobody'", "source-1")),
        (("train", "--duration", "nan"), ("--duration", "finite")),
        (("train", "--duration", "1"), ("--duration", "between 60 and 600")),
        (("transfer", "--target", "target", "--source", "nobody"), ("no robot 'nobody'",)),
        (("transfer", "--target", "target", "--source", "target"), ("among the sources",)),
        (("transfer", "--target", "target"), ("either --source or --file",)),
    ],
    ids=lambda value: "-".join(value[:1] + value[-2:]) if "--" in "".join(value) else "",
)
def test_what_nobody_can_learn_or_pass_on_is_refused(
    typed: Typed, lab: Workplace, arguments: tuple[str, ...], words: tuple[str, ...]
) -> None:
    refused(typed, lab, *arguments, words=words)


def test_a_robot_that_cannot_learn_is_refused_before_the_run_has_a_folder(
    typed: Typed, lab: Workplace, monkeypatch: pytest.MonkeyPatch
) -> None:
    def check_lessons(description: Description, architectures: object) -> None:
        raise InvalidInputError(f"robot {description.robot} cannot learn")

    monkeypatch.setattr(train, "check_lessons", check_lessons)
    refused(typed, lab, "train", "--robot", "source-1", words=("source-1 cannot learn",))


def test_without_a_prior_there_is_none_to_fly_with(typed: Typed, lab: Workplace) -> None:
    arguments = ("--target", "source-1", "--trajectory", "clover", "--inverse", "prior")
    words = ("source-1 has no prior", "nufleet transfer --target source-1")
    refused(typed, lab, "track", *arguments, words=words, robot="source-1")


GOOD = experience("source-2")


@pytest.mark.parametrize(
    ("name", "payload", "words"),
    [
        ("kind", experience(robot_kind="quadrotor"), "learned on a quadrotor"),
        ("axis", experience(axes=("y",)), "the robot has no axis 'y'"),
        ("sample-time", experience(layout=layout(sample_time_s=0.02)), "sample time is 0.02 s"),
        (
            "inputs",
            experience(layout=layout("state", states=("position", "tilt"))),
            "needs the states position, tilt, the robot measures position, velocity",
        ),
    ],
    ids=["kind", "axis", "sample-time", "inputs"],
)
def test_an_experience_that_does_not_fit_is_refused_with_the_reason(
    typed: Typed, lab: Workplace, name: str, payload: bytes, words: str
) -> None:
    file = lab.folder / f"{name}.safetensors"
    file.write_bytes(payload)
    arguments = ("--target", "target", "--file", str(file))
    refused(
        typed, lab, "transfer", *arguments, words=("does not fit target", words, "choose a source")
    )


@pytest.mark.parametrize(
    ("name", "payload", "words"),
    [
        ("truncated", GOOD[:-7], "not a safetensors file"),
        ("altered", GOOD.replace(b"preview", b"previex"), "manifest"),
        ("zip", b"PK\x03\x04" + bytes(1000), "not an experience"),
    ],
    ids=["truncated", "altered", "zip"],
)
def test_a_file_that_is_no_whole_experience_is_refused_before_a_fleet_is_reached(
    typed: Typed, tmp_path: Path, name: str, payload: bytes, words: str
) -> None:
    file = tmp_path / f"{name}.safetensors"
    file.write_bytes(payload)
    words_all = (file.name, words, "nufleet train")
    refused_at_once(typed, tmp_path, "transfer", "--file", str(file), words=words_all)


def test_a_source_that_has_not_learned_is_refused_with_what_to_do(
    typed: Typed, lab: Workplace
) -> None:
    arguments = ("--target", "target", "--source", "source-1")
    refused(typed, lab, "transfer", *arguments, words=("nufleet train --robot source-1",))


def test_an_experience_of_another_sample_time_is_refused_over_the_network_as_well(
    typed: Typed, lab: Workplace, training: dict[str, object]
) -> None:
    arguments = ("--target", "slower", "--source", "source-2")
    words = ("source-2 does not fit slower", "0.015 s, the robot's 0.02 s")
    refused(typed, lab, "transfer", *arguments, words=words, robot="slower")


def test_a_memory_that_was_altered_on_the_disk_is_not_served(
    typed: Typed, lab: Workplace, transferred: dict[str, object], tmp_path: Path
) -> None:
    (kept,) = lab.folder.glob("state/paper-linear/target/learned/prior.*")
    damaged = tmp_path / "paper-linear" / "target" / "learned" / kept.name
    damaged.parent.mkdir(parents=True)
    stored = bytearray(kept.read_bytes())
    stored[-9] ^= 1
    damaged.write_bytes(stored)
    done = typed(
        *("agent", "paper_linear", "--robot", "target", "--state", str(tmp_path)),
        *("--connect", lab.endpoint),
        cwd=tmp_path,
    )
    assert done.returncode == 1
    assert str(damaged) in done.stderr
    assert "remove it, then train or transfer again" in done.stderr
    assert "Traceback" not in done.stderr
