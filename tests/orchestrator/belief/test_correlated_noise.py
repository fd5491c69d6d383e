"""What noise that several axes share does to the belief about how they answer to one of them."""

from __future__ import annotations

import numpy as np
import pytest
from loops_on_axes import AXES, answer, spec_of
from random_loops import BAND, Loop

from nufleet.orchestrator.belief.axes_knowledge import AxesKnowledge
from nufleet.orchestrator.study.tone_choice import first_look
from nufleet.shared.arrays import ComplexArray

LOOPS = {"x": Loop(3.0), "y": Loop(3.5)}
DEVIATION = 0.03
GRID = np.linspace(*BAND, 128)
COUNT = 400


def known(across: complex, seed: int) -> AxesKnowledge:
    """A robot whose y answers to x, with noise of that correlation between y and x."""
    spec, rng = spec_of(), np.random.default_rng(seed)
    correlation: ComplexArray = np.array([[1.0, np.conj(across)], [across, 1.0]])
    found = AxesKnowledge("robot", spec, BAND[1], AXES)
    test = first_look(BAND, spec, 11, 0.7, (0, 1)).excitation(*AXES)
    response = answer(LOOPS, test, DEVIATION, rng, 0.1, correlation=correlation)
    found.learn(response, rng, check=False)
    return found


def column(robot: AxesKnowledge) -> dict[str, ComplexArray]:
    """Samples of how x and y answer to x."""
    rng = np.random.default_rng(1)
    own = robot.axes["x"].model.draw(GRID, COUNT, rng)
    drawn = robot.draw_column("x", GRID, own, rng)
    assert drawn is not None
    return drawn


def correlation(drawn: dict[str, ComplexArray]) -> ComplexArray:
    """Correlation of both responses over the samples, at each frequency."""
    x, y = (drawn[axis] - drawn[axis].mean(axis=0) for axis in AXES)
    sizes = np.linalg.norm(x, axis=0) * np.linalg.norm(y, axis=0)
    return np.asarray(np.sum(y * x.conj(), axis=0) / sizes)


@pytest.mark.parametrize("phase_rad", [0.0, 2.0, np.pi])
def test_samples_of_a_column_go_together_as_the_noise_of_its_axes_did(phase_rad: float) -> None:
    shared = np.exp(1j * phase_rad)
    low = GRID < 3.0  # where the tones say more than the belief before them
    turned = correlation(column(known(0.95 * shared, 0)))[low] / shared
    assert np.median(turned.real) > 0.5
    apart = correlation(column(known(0.0, 0)))[low]
    assert np.median(np.abs(apart)) < 0.2


def test_sums_of_answers_are_as_uncertain_as_they_are_wrong() -> None:
    squares, variances = [], []
    for seed in range(10):
        drawn = column(known(0.95, seed))
        total = drawn["x"] + drawn["y"]
        truth = LOOPS["x"].z(GRID) + 0.1 * LOOPS["y"].z(GRID)
        squares.append(np.abs(total.mean(axis=0) - truth) ** 2)
        variances.append(total.var(axis=0))
    ratio = np.sum(squares, axis=0) / np.sum(variances, axis=0)
    assert 0.4 < float(np.median(ratio)) < 1.4


def test_an_axis_that_was_never_tested_with_another_gives_no_samples() -> None:
    spec, rng = spec_of(), np.random.default_rng(0)
    found = AxesKnowledge("robot", spec, BAND[1], AXES)
    for axis in (0, 1):
        test = first_look(BAND, spec, 11, 0.7, (axis,)).excitation(*AXES)
        found.learn(answer(LOOPS, test, DEVIATION, rng), rng, check=False)
    own = found.axes["x"].model.draw(GRID, 10, rng)
    assert found.draw_column("x", GRID, own, rng) is None
