"""Everything that takes bytes from outside, each with valid examples of what it takes."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.faults.fuzzing import Target
from nufleet import sims
from nufleet.orchestrator.gap.model_files import read_model
from nufleet.orchestrator.repository.array_blob import pack_array, unpack_complex
from nufleet.orchestrator.repository.errors import DamagedRecordError
from nufleet.orchestrator.runs.folder import CONFIGURATION, RESULTS, read_record
from nufleet.orchestrator.runs.rank_result import RankResult, RunRecord
from nufleet.orchestrator.study.interface import SourceEstimate
from nufleet.robot_agent.journal.frames import encode_frame, file_head, scan
from nufleet.robot_agent.journal.journal import Journal
from nufleet.robot_agent.journal.ledger import JournalError
from nufleet.shared.errors import InvalidInputError, MalformedMessageError
from nufleet.shared.experience.file import Experience, decode_experience, encode_experience
from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.experience.manifest import ExperienceManifest
from nufleet.shared.frequency_test.excitation import Excitation, ExcitationPlan, Tone
from nufleet.shared.paths.files import read_drawing
from nufleet.shared.robots.fleet_file import read_fleet_file
from nufleet.shared.robots.spec import AxisSpec, RobotSpec
from nufleet.shared.wire import messages
from nufleet.shared.wire.codec import Message, decode, encode
from nufleet.shared.wire.frame import CHECKSUM, sealed
from nufleet.shared.wire.messages import (
    AcknowledgeRequest,
    CancelRequest,
    DescribeRequest,
    Description,
    Done,
    ExperienceFile,
    ExperienceOffer,
    FetchRequest,
    ForecastRequest,
    Foreseen,
    ForeseenWay,
    GoalAccepted,
    GoalRequest,
    GoalResult,
    InstallRequest,
    Outcome,
    PathForecast,
    Refusal,
    ReleaseRequest,
    RemovePriorRequest,
    ResultRequest,
    RobotState,
    RobotStatus,
    StopRequest,
    Telemetry,
    TrackingTelemetry,
)
from nufleet.shared.wire.motions import (
    Motion,
    RichFlight,
    RichFlightDetails,
    StepTest,
    Tracking,
    Weighted,
)

PLAN = ExcitationPlan(
    axis="x",
    tones=(Tone(omega_rad_s=1.0), Tone(omega_rad_s=3.5, weight=0.5, phase_rad=1.0)),
    amplitude=0.5,
    sample_time_s=0.01,
    ramp_samples=10,
    settle_samples=0,
    segments=3,
    segment_samples=20,
)
SPEC = RobotSpec(
    kind="double-integrator",
    axes=(
        AxisSpec(name="x", unit="m", amplitude_max=1.0, velocity_max=2.0, acceleration_max=10.0),
    ),
    sample_time_s=0.015,
    omega_min_rad_s=0.01,
    omega_max_rad_s=50.0,
    duration_max_s=3600.0,
    settling_time_s=2.0,
    simulated=True,
)
LAYOUT = InverseLayout(
    architecture="preview", states=("position",), sample_time_s=0.015, horizon_samples=4
)
SIGNAL, FLIGHT = np.linspace(-1.0, 1.0, 80), np.linspace(-1.0, 1.0, 80).reshape(40, 2)


def experience(robot: str = "a") -> Experience:
    """Return a small inverse of the robots of Section V, learned by one of them."""
    width = len(LAYOUT.input_names)
    manifest = ExperienceManifest(
        robot=robot,
        robot_kind=SPEC.kind,
        axes=("x",),
        unit="m",
        layout=LAYOUT,
        inputs=LAYOUT.input_names,
        relative_degree=1,
        hidden=(4,),
        input_mean=(0.0,) * width,
        input_scale=(1.0,) * width,
        output_mean=0.0,
        output_scale=1.0,
        points=500,
        validation_rms=0.1,
        data_sha256="0" * 64,
        seed=0,
        training_version="1",
    )
    rng = np.random.default_rng(0)
    arrays = {
        name: rng.standard_normal(shape).astype(np.float32)
        for name, shape in manifest.shapes.items()
    }
    return Experience(manifest, arrays)


def example_messages() -> list[Message]:
    """Return valid messages, at least one of every type."""
    stored = experience()
    offer = ExperienceOffer(sha256="0" * 64, size_bytes=3, manifest=stored.manifest)
    goal = {"goal_id": "run-1.2.a.1", "boot_id": "b00f", "plan": PLAN, "reason": ""}
    motions: tuple[Motion, ...] = (
        Excitation(axis="x", tones=PLAN.tones, settle_s=0.5),
        StepTest(axis="x"),
        RichFlight(duration_s=20.0, seed=3),
        Tracking(desired=FLIGHT, inverse="zero-prior", layout=LAYOUT),
        Tracking(
            desired=FLIGHT, inverse="mixture", mixture=(Weighted(sha256="0" * 64, weight=0.5),)
        ),
    )
    states = RichFlightDetails(state_names=("position",), states=FLIGHT.reshape(40, 2, 1))
    path = dict.fromkeys(("desired", "actual", "prior", "mean", "variance"), FLIGHT)
    return [
        Refusal(code="busy", reason="running goal g of another owner"),
        DescribeRequest(),
        Description(robot="a", boot_id="b00f", spec=SPEC, experiences=(offer,), prior=offer),
        *(
            GoalRequest(goal_id=f"g{k}", owner="me", motion=m, acknowledges=("g0",))
            for k, m in enumerate(motions)
        ),
        GoalAccepted(goal_id="g", boot_id="b00f", plan=PLAN, wall_duration_s=1.0),
        CancelRequest(sender="me", goal_id="g"),
        ResultRequest(goal_id="g"),
        AcknowledgeRequest(sender="me", goal_ids=("g", "g2")),
        GoalResult.model_validate(
            {**goal, "outcome": Outcome.COMPLETED, "reference": SIGNAL, "response": SIGNAL}
        ),
        GoalResult.model_validate(
            {
                **goal,
                "outcome": Outcome.FAILED,
                "reference": FLIGHT,
                "response": FLIGHT,
                "details": states,
                "plan": {
                    "kind": "flight",
                    "sample_time_s": 0.01,
                    "samples": 40,
                    "duration_s": 1.0,
                },
            }
        ),
        FetchRequest(sha256="0" * 64),
        ExperienceFile(sha256="0" * 64, payload=encode_experience(stored)),
        offer,
        InstallRequest(sender="me", sha256="0" * 64, payload=encode_experience(stored)),
        RemovePriorRequest(sender="me"),
        ForecastRequest(desired=FLIGHT, ways=(ForeseenWay(inverse="baseline"),)),
        PathForecast(foreseen=(None, Foreseen(code="no-prior", reason="it holds none"))),
        StopRequest(sender="me", reason="smoke"),
        ReleaseRequest(sender="me"),
        Done(),
        RobotState(
            robot="a",
            boot_id="b00f",
            sequence=4,
            status=RobotStatus.RUNNING,
            goal_id="g",
            progress=0.5,
            reason="",
            last_goal_id=None,
            robot_time_s=1.0,
        ),
        Telemetry(
            goal_id="g", first_sample=0, sample_time_s=0.01, reference=SIGNAL, response=SIGNAL
        ),
        TrackingTelemetry(
            goal_id="g", first_sample=0, sample_time_s=0.01, share=FLIGHT[:, 0], **path
        ),
    ]


def every_type_of_message() -> list[type[Message]]:
    """Return all messages that there are."""
    found = [value for value in vars(messages).values() if isinstance(value, type)]
    return [one for one in found if issubclass(one, Message) and one is not Message]


def decoding_targets() -> list[Target]:
    """Return what takes bytes without a file: messages, experiences, arrays, journals."""
    by_type: dict[type[Message], list[bytes]] = {}
    for message in example_messages():
        by_type.setdefault(type(message), []).append(encode(message)[: -CHECKSUM.size])
    salt = bytes(range(16))
    records = tuple(b"record %d" % n for n in (1, 2, 3))
    frames = [encode_frame(salt, n, record) for n, record in enumerate(records, start=1)]
    spectrum = np.exp(1j * np.arange(12))
    return [
        *(
            Target(
                f"decode {kind.__name__}",
                seeds,
                partial(_decoded, kind),
                (MalformedMessageError,),
            )
            for kind, seeds in by_type.items()
        ),
        Target(
            "an experience",
            [encode_experience(experience())],
            decode_experience,
            (MalformedMessageError,),
        ),
        Target(
            "an array of the repository",
            [pack_array(spectrum)],
            lambda blob: unpack_complex(blob, (12,), "z"),
            (DamagedRecordError,),
        ),
        Target(
            "a journal's frames",
            [file_head(salt) + b"".join(frames)],
            partial(_scanned, records),
            (),
        ),
    ]


def file_targets(folder: Path) -> list[Target]:
    """Return what reads files, which are written into a folder."""
    fleets = Path(sims.__file__).parent / "fleets"
    drawing = b"x_m,y_m\n0,0\n0.5,0.25\n1,0\n"
    drawn = (
        b'<svg><path d="M 0 0 L 10 5 C 1 2 3 4 5 6 Q 1 2 3 4 H 3 V 4 A 1 2 3 0 1 5 6 Z"/>'
        b'<g transform="rotate(3)"><circle r="1mm"/></g></svg>'
    )
    transfer = json.dumps({"num": [1.0, 2.0], "den": [1.0, 0.5, 3.0], "dt": 0.01}).encode()
    space = json.dumps({"A": [[0.5]], "B": [[1.0]], "C": [[1.0]], "D": [[0.0]], "dt": 0.01})
    table = b"omega_rad_s,real,imag,variance\n1,0.5,-0.5,0.01\n2,0.25,-0.5,0.02\n"
    journal = folder / "journal"
    with Journal(journal):
        pass
    log = next(p for p in sorted(journal.iterdir()) if p.is_file() and p.stat().st_size > 0)
    run = folder / "run"
    run.mkdir()
    (run / CONFIGURATION).write_text("{}")
    return [
        _file_target("a fleet file", folder / "fleet.toml", read_fleet_file, fleet_files(fleets)),
        _file_target("a drawing (CSV)", folder / "drawing.csv", read_drawing, [drawing]),
        _file_target("a drawing (SVG)", folder / "drawing.svg", read_drawing, [drawn]),
        _file_target(
            "a model (JSON)", folder / "model.json", read_model, [transfer, space.encode()]
        ),
        _file_target("a response (CSV)", folder / "response.csv", read_model, [table]),
        _file_target(
            "a run's results", run / RESULTS, lambda _: read_record(run), [results_example()]
        ),
        _file_target(
            f"a journal ({log.name})",
            log,
            lambda _: _opened(journal),
            [log.read_bytes()],
            (JournalError,),
        ),
    ]


def fleet_files(folder: Path) -> list[bytes]:
    """Return the contents of the fleet files in a folder."""
    return [path.read_bytes() for path in sorted(folder.glob("*.toml"))]


def results_example() -> bytes:
    """Return a run's results as they are stored."""
    estimate = SourceEstimate("source-1", 0.1, 0.08, 0.12, 4.0, 7)
    result = RankResult(
        target="target",
        band_rad_s=(0.5, 10.0),
        selected="source-1",
        ranking=(estimate,),
        iterations=7,
        robot_time_s=100.0,
        run="runs/1",
        verdicts={},
    )
    whole = RunRecord(
        result=result,
        axis="x",
        seed=0,
        history=(),
        dropped={},
        closed_form={},
        responses={},
        wall_time_s=1.0,
    )
    return whole.model_dump_json(by_alias=True, exclude_none=True).encode()


def _decoded(kind: type[Message], payload: bytes) -> Message:
    # With its own checksum nothing that was changed would be read.
    return decode(sealed(payload), kind)


def _scanned(records: tuple[bytes, ...], payload: bytes) -> None:
    found = scan(payload).payloads
    if not set(found) <= set(records):
        raise ValueError(f"records that were never written: {found}")


def _opened(folder: Path) -> None:
    with Journal(folder):
        pass


def _file_target(
    name: str,
    path: Path,
    read: Callable[[Path], object],
    seeds: list[bytes],
    refusals: tuple[type[Exception], ...] = (InvalidInputError,),
) -> Target:
    def take(payload: bytes) -> object:
        path.write_bytes(payload)
        return read(path)

    return Target(name, seeds, take, refusals)
