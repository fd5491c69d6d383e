"""Experiences outlive the robots that learned them: stored, found, transferred and flown with."""

from __future__ import annotations

import json
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest
from command_processes import Typed, begun
from fleet_lab import Lab, Orchestrator, double_integrator
from learned_things import experience, layout
from polling import PATIENCE_S
from postgresql_server import PostgresqlServer, running_server
from rich.console import Console
from sqlalchemy import create_engine

from nufleet.orchestrator.conduct.rank_run import RankRequest, prepare
from nufleet.orchestrator.evaluation.run import EvaluationPlan, prepare_robots
from nufleet.orchestrator.experience.library import ExperienceLibrary
from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.experience.transfer import transfer
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.orchestrator.jobs.transfer import TransferCommand, TransferResult
from nufleet.orchestrator.jobs.transfer import transfer as run_transfer
from nufleet.orchestrator.repository.address import default_url, parse_url
from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.orchestrator.repository.records import ExperienceRecord, RobotRecord
from nufleet.orchestrator.repository.repository import Repository, open_repository
from nufleet.orchestrator.repository.tables import EXPERIENCES
from nufleet.orchestrator.runs.folder import RunFolder
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.file import decode_experience, digest
from nufleet.shared.wire.session import Session

FLEET = """
schema = 1
name = "lab"

[robots.target]
driver = "double_integrator"
settings = { alpha = 0.85, beta = 0.003 }

[robots.source]
driver = "double_integrator"
settings = { alpha = 0.97, beta = 0.004 }
"""


@pytest.fixture(scope="module", autouse=True)
def server() -> Iterator[PostgresqlServer]:
    """A server that runs before the first test, which may leave no process of its own behind."""
    with running_server() as running:
        yield running


@pytest.fixture(params=["sqlite", "postgresql"])
def address(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """The address of an empty repository that several orchestrators share."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path}/shared.sqlite"
    running: PostgresqlServer = request.getfixturevalue("server")
    return running.empty_database()


@contextmanager
def agent_of(robot: str, endpoint: str, folder: Path) -> Iterator[None]:
    """Keep a robot's agent running as a process; it is killed in the end."""
    file, state = folder / "lab.toml", folder / robot
    file.write_text(FLEET)
    words = ("agent", str(file), "--robot", robot, "--connect", endpoint)
    process = begun(*words, cwd=folder, state=state)
    try:
        yield
    finally:
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=PATIENCE_S)


@pytest.fixture
def _target(router: Session, endpoint: str, tmp_path: Path) -> Iterator[None]:
    with agent_of("target", endpoint, tmp_path):
        yield


@pytest.mark.usefixtures("_target")
def test_an_experience_is_transferred_and_flown_with_after_its_robot_is_gone(
    lab: Lab, address: str, tmp_path: Path, typed: Typed
) -> None:
    def command(name: str, runs: str, *words: str) -> tuple[dict[str, object], str]:
        """Run a command, each of which is an orchestrator of its own."""
        where = ("--connect", lab.endpoint, "--repository", address, "--runs", runs, "--json")
        waits_for_nothing = () if name == "train" else ("--no-rehearsal",)
        waits_for_nothing += ("--no-recording",) if name == "rank" else ()
        done = typed(name, *where, *waits_for_nothing, *words, cwd=tmp_path)
        assert done.returncode == 0, done.stderr
        return json.loads(done.stdout), done.stderr

    with agent_of("source", lab.endpoint, tmp_path):
        lab.orchestrator("tester", "target", "source")
        learn = ("--robot", "source", "--architecture", "preview", "--duration", "60")
        trained, _ = command("train", "there", *learn)
        command("rank", "there", "--target", "target", "--band", "0.5", "10", "--iterations", "1")
    (learned,) = trained["experiences"]  # type: ignore[misc]

    # Another orchestrator, elsewhere: it shares nothing with the first one but the repository.
    given, said = command("transfer", "here", "--target", "target", "--source", "best")
    assert (given["source"], given["sha256"]) == ("source", learned["sha256"])
    assert given["manifest"] == learned["manifest"]
    assert given["taken_from"] == "repository"
    assert "taken from the repository, learned" in said
    assert "ago: source does not answer" in said
    by_name, _ = command("transfer", "here", "--target", "target", "--source", "source")
    assert by_name == given

    flown, _ = command("track", "here", "--target", "target", "--trajectory", "clover")
    alone, _ = command(
        *("track", "here", "--target", "target", "--trajectory", "clover"),
        *("--inverse", "baseline"),
    )
    (flight,), (baseline,) = flown["flights"], alone["flights"]  # type: ignore[misc]
    assert (flight["inverse"], flight["failure"], flight["taken_back"]) == ("source", None, None)
    assert flight["rms_m"] < 0.2 * baseline["rms_m"]


# What is taken, when both the source and the repository have one.


@pytest.fixture
def repository(address: str) -> Iterator[Repository]:
    with open_repository(address) as opened:
        yield opened


@pytest.fixture
def orchestrator(lab: Lab) -> Orchestrator:
    for k, robot in enumerate(("source", "target")):
        lab.agent(robot, double_integrator(0.85, k))
    return lab.orchestrator()


OLD, NEW = experience("source", seed=1), experience("source", seed=2)


def learned(
    orchestrator: Orchestrator, repository: Repository, payload: bytes, robot: str = "source"
) -> None:
    """Store an experience as `nufleet train` does, whether its robot is there or not."""
    spec = orchestrator.fleet.describe("target").spec
    repository.robots.describe(RobotRecord("lab", robot, spec, "boot-1"))
    repository.robots.add_experience(ExperienceRecord("lab", "run-1", payload))


def prior_of(orchestrator: Orchestrator) -> str | None:
    prior = orchestrator.fleet.describe("target").prior
    return None if prior is None else prior.sha256


@pytest.mark.parametrize(
    ("stored", "offered", "taken", "place", "words"),
    [
        ([OLD], NEW, NEW, "robot", "offers one that the repository does not have"),
        ([OLD, NEW], NEW, NEW, "robot", "source offers it"),
        ([OLD, NEW], OLD, NEW, "repository", "source offers the older"),
        ([OLD], None, OLD, "repository", "source does not offer preview now"),
        ([], NEW, NEW, "robot", "source offers it"),
    ],
    ids=["learned elsewhere", "the same", "restored", "forgotten", "never stored"],
)
def test_a_source_that_is_there_passes_on_the_newest_experience_that_is_known(
    orchestrator: Orchestrator,
    repository: Repository,
    stored: list[bytes],
    offered: bytes | None,
    taken: bytes,
    place: str,
    words: str,
) -> None:
    fleet = orchestrator.fleet
    for payload in stored:
        learned(orchestrator, repository, payload)
    if offered is not None:
        install(fleet, "source", "experience", offered)
    library = ExperienceLibrary(fleet, repository.robots, "lab")
    given = transfer(fleet, library, "source", fleet.describe("target"))
    assert (given.sha256, given.place) == (digest(taken), place)
    assert words in given.reason
    assert (given.learned_at is None) == (taken not in stored)
    assert prior_of(orchestrator) == digest(taken)


def test_a_fleet_that_exists_for_one_run_takes_nothing_from_robots_of_the_same_name(
    orchestrator: Orchestrator, repository: Repository
) -> None:
    fleet = orchestrator.fleet
    learned(orchestrator, repository, OLD)
    with pytest.raises(InvalidInputError, match="it offers none"):
        transfer(fleet, ExperienceLibrary(fleet), "source", fleet.describe("target"))


def test_an_experience_that_an_evaluation_trains_is_stored(
    orchestrator: Orchestrator, tmp_path: Path
) -> None:
    fleet = orchestrator.fleet
    request = RankRequest("target", ("source",), (0.5, 10.0), iterations=1, seed=0, axes=None)
    plan = EvaluationPlan(
        ready=prepare(fleet, request, fleet.robots()),
        legs=(),
        architecture="preview",
        seeds=(0,),
        seed=0,
        flight_s=60.0,
    )
    with (
        open_repository(str(tmp_path / "nufleet.sqlite")) as repository,
        RunFolder(tmp_path, "lab-evaluate") as folder,
    ):
        library = ExperienceLibrary(fleet, repository.robots, "lab")
        pilot, quiet = Pilot(fleet, "run"), lambda text: None
        prepare_robots(fleet, pilot, library, plan, ("source",), folder, say=quiet)
        (stored,) = repository.robots.experiences("lab", "source")
        payload = repository.robots.experience("lab", stored.sha256)
    (offer,) = fleet.describe("source").experiences
    assert (stored.sha256, stored.run) == (offer.sha256, folder.path.name)
    assert fleet.fetch("source", offer.sha256) == payload


def test_a_script_transfers_a_stored_experience_without_a_word(
    orchestrator: Orchestrator, lab: Lab, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    with open_repository(default_url(tmp_path)) as repository:
        learned(orchestrator, repository, experience("away"), "away")
    command = TransferCommand(
        connect=lab.endpoint,
        fleet_name=None,
        target="target",
        source="away",
        file=None,
        architecture=None,
        runs_root=tmp_path,
        repository=None,
        as_json=False,
    )
    given = run_transfer(command, Console(quiet=True))
    assert (given.source, given.target, given.taken_from) == ("away", "target", "repository")
    assert given.sha256 == digest(experience("away")) == prior_of(orchestrator)
    assert given.manifest == decode_experience(experience("away")).manifest
    assert given.learned_at is not None
    gone = run_transfer(replace(command, source="none"), Console(quiet=True))
    assert gone == TransferResult(target="target")
    assert prior_of(orchestrator) is None
    assert capfd.readouterr() == ("", "")


# What is refused, with the target's prior as it was.


@pytest.mark.parametrize(
    ("source", "words"),
    [
        ("nobody", "no robot 'nobody' in this fleet; there are source, target, and the repository"),
        ("source", "it offers none; train one with `nufleet train --robot source`"),
    ],
)
def test_a_source_that_is_unknown_or_has_learned_nothing_is_refused(
    orchestrator: Orchestrator, repository: Repository, source: str, words: str
) -> None:
    fleet = orchestrator.fleet
    learned(orchestrator, repository, experience("away"), "away")
    library = ExperienceLibrary(fleet, repository.robots, "lab")
    with pytest.raises(InvalidInputError, match=words):
        transfer(fleet, library, source, fleet.describe("target"))
    assert prior_of(orchestrator) is None


@pytest.mark.parametrize(
    ("changes", "reason"),
    [
        ({"robot_kind": "quadrotor"}, "learned on a quadrotor, this robot is a double-integrator"),
        ({"axes": ("y",)}, "the robot has no axis 'y'"),
        ({"unit": "rad"}, "it is in rad, axis 'x' is in m"),
        ({"layout": layout(sample_time_s=0.02)}, "its sample time is 0.02 s"),
    ],
    ids=["kind", "axis", "unit", "sample time"],
)
def test_a_stored_experience_that_does_not_fit_is_refused_with_the_reason(
    orchestrator: Orchestrator,
    repository: Repository,
    changes: dict[str, object],
    reason: str,
) -> None:
    fleet = orchestrator.fleet
    learned(orchestrator, repository, experience("away", **changes), "away")
    library = ExperienceLibrary(fleet, repository.robots, "lab")
    with pytest.raises(InvalidInputError, match=f"away does not fit target: .*{reason}"):
        transfer(fleet, library, "away", fleet.describe("target"))
    assert prior_of(orchestrator) is None


def test_a_damaged_experience_is_not_transferred_until_its_robot_has_learned_again(
    orchestrator: Orchestrator, repository: Repository, address: str
) -> None:
    fleet = orchestrator.fleet
    learned(orchestrator, repository, experience("away", seed=1), "away")
    engine = create_engine(parse_url(address))
    with engine.begin() as connection:
        connection.execute(EXPERIENCES.update().values(payload=experience("away", seed=2)))
    engine.dispose()
    library = ExperienceLibrary(fleet, repository.robots, "lab")
    with pytest.raises(DamagedRecordError, match=r"robot away .* sha256 .*nufleet train"):
        transfer(fleet, library, "away", fleet.describe("target"))
    assert prior_of(orchestrator) is None
    again = experience("away", seed=3)
    learned(orchestrator, repository, again, "away")
    transfer(fleet, library, "away", fleet.describe("target"))
    assert prior_of(orchestrator) == digest(again)


def test_an_unknown_source_is_refused_by_the_command_with_what_there_is(
    lab: Lab, address: str, tmp_path: Path, typed: Typed
) -> None:
    lab.agent("target", double_integrator(0.85, 1))
    words = ("transfer", "--target", "target", "--source", "away", "--connect", lab.endpoint)
    done = typed(*words, "--repository", address, cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert "no robot 'away' in this fleet; there are target" in done.stderr
    assert "Traceback" not in done.stderr
