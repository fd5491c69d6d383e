"""One `nufleet train`: robots fly lessons, networks are trained and installed on their robots."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from nufleet.orchestrator.experience.learning import FLIGHT_S, Lesson, Say, fly_lessons
from nufleet.orchestrator.experience.prior_custody import install
from nufleet.orchestrator.experience.training import train
from nufleet.orchestrator.fleet.client import Fleet
from nufleet.orchestrator.flights.pilot import Pilot
from nufleet.shared.experience.file import Experience, encode_experience
from nufleet.shared.experience.layout import Architecture
from nufleet.shared.wire.messages import Description

TRAINING_THREADS = 2
"""Number of networks that are trained at the same time."""


@dataclass(frozen=True, eq=False)
class Trained:
    """An experience that its robot now offers to others."""

    lesson: Lesson
    """Flights that it was learned from."""
    experience: Experience
    """The trained network with its manifest."""
    payload: bytes
    """Content of the experience's file."""
    sha256: str
    """Hash of the experience's file."""
    training_time_s: float
    """Wall time that training and installing took."""


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
    on_step: Callable[[str, int, int], None] = lambda robot, done, most: None,
    on_trained: Callable[[Trained], None] = lambda trained: None,
) -> tuple[Trained, ...]:
    """Have robots learn experiences of their own; all robots fly at the same time.

    Args:
        fleet: Client of the fleet, already connected.
        pilot: Pilot that has the robots fly.
        robots: Descriptions of the robots that learn.
        architectures: Architectures of the experiences to learn.
        folder: Folder in which a copy of each experience is stored.
        seed: Seed of the flights and of the networks' first weights.
        duration_s: Duration of each rich flight.
        say: Callback that receives a robot's name and its present activity, from several threads.
        on_step: Callback that receives, while a network is trained, its robot, the steps that are
            done, and how many there are at most; from several threads.
        on_trained: Callback that receives each experience once its robot holds it, from several
            threads.

    Returns:
        All experiences, in the order of the robots and then of the architectures.

    Raises:
        InvalidInputError: A network has to be trained, and torch is not installed.
        StudyError: A robot does not respond to steps, or no horizon can be flown on it.
        RobotError: A flight failed. Errors of the connection are raised as they are.
    """
    folder.mkdir(parents=True, exist_ok=True)

    def lessons_of(description: Description) -> tuple[Lesson, ...]:
        every = (pilot, fleet, description, architectures)
        return fly_lessons(*every, seed=seed, duration_s=duration_s, say=say)

    def trained(lesson: Lesson) -> Trained:
        began_s = time.monotonic()
        architecture = lesson.choice.layout.architecture
        say(lesson.robot, f"has flown; its {architecture} network is trained")
        layout, stepped = lesson.choice.layout, partial(on_step, lesson.robot)
        experience = train(lesson.data, layout, lesson.origin, seed=seed, stepped=stepped)
        payload, file = encode_experience(experience), f"{lesson.robot}-{architecture}.safetensors"
        (folder / file).write_bytes(payload)
        sha256, signed = install(fleet, lesson.robot, "experience", payload)
        (folder / file).write_bytes(signed)
        done = Trained(lesson, experience, signed, sha256, time.monotonic() - began_s)
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
            # On Ctrl-C, or when one robot has failed, no other may fly on unattended.
            pilot.interrupt()
            training.shutdown(wait=False, cancel_futures=True)
            raise
