"""The priors of a flight: one of all axes, or one experience for each."""

from __future__ import annotations

import numpy as np
import pytest
from learned_things import experience, layout

from nufleet.robot_agent.flight.memory import Kept, Memory
from nufleet.robot_agent.flight.online_gp import OnlineGp
from nufleet.robot_agent.flight.prior_learner import prior_learner
from nufleet.shared.arrays import FloatArray
from nufleet.shared.errors import RobotError
from nufleet.shared.experience.combined_layout import CombinedLayout
from nufleet.shared.experience.file import digest
from nufleet.shared.wire.motions import AxisPrior, Tracking

PATH = np.zeros((20, 2))
AXES = ("x", "y")
SHORT = experience("short", axes=AXES)
LONG = experience("long", seed=1, axes=AXES, layout=layout(horizon_samples=30))


def holding(*payloads: bytes) -> tuple[Memory, tuple[Kept, ...]]:
    memory = Memory(None)
    for payload in payloads:
        memory.keep_prior(payload, digest(payload), beside=True)
    return memory, memory.priors


def flown(memory: Memory, first: bytes, **by_axis: bytes) -> tuple[FloatArray, FloatArray]:
    """What a flight's priors say at inputs of both axes: the inputs, and γ as of the leading."""
    chosen = tuple(AxisPrior(axis=axis, sha256=digest(own)) for axis, own in by_axis.items())
    motion = Tracking(
        desired=PATH, inverse="prior", prior_sha256=digest(first), prior_by_axis=chosen
    )
    learner = prior_learner(motion, AXES, memory, 0)
    assert isinstance(learner.process, OnlineGp)
    rng = np.random.default_rng(2)
    inputs = rng.standard_normal((2, len(learner.layout.input_names)))
    return inputs, learner.process.correct(inputs).prior


def test_each_axis_takes_the_experience_that_was_chosen_for_it() -> None:
    memory, (short, long) = holding(SHORT, LONG)
    combined = CombinedLayout([short.manifest.layout, long.manifest.layout])
    inputs, gamma = flown(memory, SHORT, y=LONG)
    own = [combined.inputs_of(one.manifest.layout, inputs) for one in (short, long)]
    assert gamma[0] == pytest.approx(float(short.inverse(own[0])[0]))
    # What a preview of 30 samples says is a distance, which one of 20 would reach sooner.
    assert gamma[1] == pytest.approx(1.5 * float(long.inverse(own[1])[1]))


def test_one_prior_of_all_axes_is_as_its_file_says() -> None:
    memory, (short,) = holding(SHORT)
    inputs, gamma = flown(memory, SHORT)
    assert gamma == pytest.approx(short.inverse(inputs))
    assert flown(memory, SHORT, x=SHORT, y=SHORT)[1] == pytest.approx(gamma)


def test_an_axis_on_which_its_prior_was_not_learned_begins_without() -> None:
    memory, _ = holding(experience(axes=("x",)))
    _, gamma = flown(memory, experience(axes=("x",)))
    assert gamma[0] != 0
    assert gamma[1] == 0


def test_a_prior_that_is_gone_is_no_prior() -> None:
    memory, _ = holding(SHORT)
    with pytest.raises(RobotError, match="no longer has a prior"):
        flown(memory, SHORT, y=LONG)
