"""One `nufleet train`: robots fly their lessons, networks are trained, robots get them back."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

from nufleet.orchestrator.experience.learning import FLIGHT_S, Lesson, Say, fly_lessons
from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.experience.training import train
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.shared.errors import InvalidInputError
from nufleet.shared.experience.file import Experience, encode_experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description

TRAINING_THREADS = 2
"""Networks that are trained at the same time."""


@dataclass(frozen=True, eq=False)
class Trained:
    """An experience that its robot offers now."""

    lesson: Lesson
    experience: Experience
    sha256: str
    training_time_s: float


def check_torch() -> None:
    """Raise InvalidInputError unless networks can be trained here."""
    if find_spec("torch") is None:
        raise InvalidInputError(
            "training needs torch: pip install 'nufleet[learning]' beside the orchestrator"
        )


def train_robots(
    fleet: Fleet,
    pilot: Pilot,
    robots: Sequence[Description],
    architectures: tuple[Architecture, ...],
    folder: Path,
    *,
    seed: int,
    duration_s: float = FLIGHT_S,
    say: Say,
    on_trained: Callable[[Trained], None] = lambda trained: None,
) -> tuple[Trained, ...]:
    """Give robots experiences of their own; all fly at the same time.

    Args:
        fleet: the fleet, reached.
        pilot: flies.
        robots: who learns.
        architectures: of the experiences.
        folder: where the files are kept too.
        seed: draws flights and first weights.
        duration_s: of each rich flight.
        say: is told (robot, what it does now), from several threads.
        on_trained: is told of each experience that its robot has.

    Raises:
        InvalidInputError: torch is not installed.
        RobotError: a flight failed; so do StudyError and what the network raises.
    """
    check_torch()
    folder.mkdir(parents=True, exist_ok=True)

    def lessons_of(description: Description) -> tuple[Lesson, ...]:
        return fly_lessons(
            pilot,
            fleet,
            description,
            architectures,
            seed=seed,
            duration_s=duration_s,
            say=say,
        )

    def trained(lesson: Lesson) -> Trained:
        began_s = time.monotonic()
        architecture = lesson.choice.layout.architecture
        say(lesson.robot, f"has flown; its {architecture} network is trained")
        experience = train(lesson.data, lesson.choice.layout, lesson.origin, seed=seed)
        payload = encode_experience(experience)
        (folder / f"{lesson.robot}-{architecture}.safetensors").write_bytes(payload)
        offer = install(fleet, lesson.robot, "experience", payload)
        done = Trained(lesson, experience, offer.sha256, time.monotonic() - began_s)
        on_trained(done)
        return done

    with (
        ThreadPoolExecutor(len(robots), thread_name_prefix="lessons") as flying,
        ThreadPoolExecutor(TRAINING_THREADS, thread_name_prefix="training") as training,
    ):
        try:
            lessons = [flying.submit(lessons_of, description) for description in robots]
            networks = [
                training.submit(trained, lesson) for flown in lessons for lesson in flown.result()
            ]
            return tuple(network.result() for network in networks)
        except BaseException:
            # Ctrl-C, or one robot failed: no other flies on alone.
            pilot.interrupt()
            training.shutdown(wait=False, cancel_futures=True)
            raise
