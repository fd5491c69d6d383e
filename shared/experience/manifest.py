"""The description of an inverse model: its origin, its inputs, its output and its layers."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Digest, Name, NonNegative, Positive, Strict

HORIZON_S = 0.4
"""Longest horizon of a feedback that learns from nothing.

A quick robot that aims 0.7 s ahead, as the experience of a slow source does, leaves nearly three
times the error that it leaves when it aims 0.4 s ahead; a slow robot leaves 6 % more at 0.4 s than
at 0.7 s."""

_Numbers = Annotated[tuple[float, ...], Field(min_length=1, max_length=64)]
_Scales = Annotated[tuple[Positive, ...], Field(min_length=1, max_length=64)]


class ExperienceManifest(Strict):
    """Origin of an inverse model and conditions of its use.

    The network is evaluated at (ξ − `input_mean`) / `input_scale`; its output times `output_scale`
    plus `output_mean` is γ in unit/s.
    """

    schema_version: Literal[1] = 1
    """Version of this schema."""
    robot: Name
    """Name of the robot that learned the model."""
    robot_kind: Name
    """Kind of that robot; only robots of the same kind can use the model."""
    axes: Annotated[tuple[Name, ...], Field(min_length=1, max_length=16)]
    """Axes whose flights the model was learned from."""
    unit: Literal["m", "rad"]
    """Unit of these axes."""
    layout: InverseLayout
    """Inputs and output of the model."""
    inputs: Annotated[tuple[str, ...], Field(min_length=1, max_length=64)]
    """Names of the inputs, equal to those of the layout."""
    output: Literal["reference-speed"] = "reference-speed"
    """Name of the output γ."""
    relative_degree: Annotated[int, Field(ge=1, le=1000)]
    """Number of samples after which the robot's output first responds to its reference."""
    hidden: Annotated[tuple[Annotated[int, Field(ge=1, le=256)], ...], Field(max_length=8)] = (
        128,
        128,
        128,
        128,
    )
    """Widths of the hidden layers; without any the model is linear."""
    input_mean: _Numbers
    """Offset of each input, in the input's own unit."""
    input_scale: _Scales
    """Scale of each input, in the input's own unit."""
    output_mean: float
    """Offset of the output, in unit/s."""
    output_scale: Positive
    """Scale of the output, in unit/s."""
    points: Annotated[int, Field(ge=1)]
    """Number of training pairs."""
    validation_rms: NonNegative
    """Root mean square error of γ on held-out pairs, in unit/s."""
    data_sha256: Digest
    """SHA-256 of the training data."""
    seed: Annotated[int, Field(ge=0)]
    """Seed of the random generator used in training."""
    training_version: Annotated[str, Field(max_length=100)]
    """Version of the training program."""

    @model_validator(mode="after")
    def _consistent(self) -> ExperienceManifest:
        if self.inputs != self.layout.input_names:
            raise ValueError(f"inputs must be those of the layout: {self.layout.input_names}")
        if not len(self.inputs) == len(self.input_mean) == len(self.input_scale):
            raise ValueError("input_mean and input_scale need one number per input")
        if len(set(self.axes)) != len(self.axes):
            raise ValueError(f"axis names must differ, got {self.axes}")
        return self

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of every array of the network.

        A weight has shape (inputs of its layer, outputs of its layer), a bias (outputs,).
        """
        widths = (len(self.inputs), *self.hidden, 1)
        shapes: dict[str, tuple[int, ...]] = {}
        for layer, (before, after) in enumerate(pairwise(widths)):
            shapes[f"weight_{layer}"] = (before, after)
            shapes[f"bias_{layer}"] = (after,)
        return shapes


def without_experience(held: Sequence[ExperienceManifest]) -> InverseLayout:
    """Return the layout of learning from nothing, beside experiences of one architecture.

    A feedback takes the shortest horizon of the experiences, at most `HORIZON_S` unless their
    robots' delay is longer. With a preview γ = 0 sends the path itself at any horizon, and
    the first layout serves.

    Args:
        held: Manifests of the experiences, at least one.
    """
    if held[0].layout.architecture == "preview":
        return held[0].layout
    shortest = min(held, key=lambda manifest: manifest.layout.horizon_samples)
    layout = shortest.layout
    longest = max(shortest.relative_degree, round(HORIZON_S / layout.sample_time_s))
    return layout.model_copy(update={"horizon_samples": min(layout.horizon_samples, longest)})


@dataclass(frozen=True)
class Needs:
    """Requirements that a robot must meet to use an experience."""

    robot_kind: str
    """Kind of robot."""
    axes: tuple[str, ...]
    """Axes on which the experience may be used."""
    unit: str
    """Unit of these axes."""
    sample_time_s: float
    """Sample time of the robot."""
    states: tuple[str, ...]
    """States that the robot must measure, in this order before any others; a preview needs none."""


def needs_of(manifest: ExperienceManifest) -> Needs:
    """Return the requirements for flying with an experience.

    Args:
        manifest: Manifest of the experience.
    """
    layout = manifest.layout
    return Needs(
        robot_kind=manifest.robot_kind,
        axes=manifest.axes,
        unit=manifest.unit,
        sample_time_s=layout.sample_time_s,
        states=layout.measured_states,
    )


def misfit(
    manifest: ExperienceManifest, spec: RobotSpec, state_names: tuple[str, ...], axis: str
) -> str | None:
    """Return the reason why an experience cannot be used on an axis of a robot; None if it can.

    Args:
        manifest: Manifest of the experience.
        spec: Description of the robot that would use it.
        state_names: Names of the states that this robot measures.
        axis: Name of the axis to be driven.
    """
    return unmet(needs_of(manifest), spec, state_names, axis)


def unmet(needs: Needs, spec: RobotSpec, state_names: tuple[str, ...], axis: str) -> str | None:
    """Return the first requirement that an axis of a robot does not meet; None if it meets all.

    Args:
        needs: Requirements of the experience.
        spec: Description of the robot that would use it.
        state_names: Names of the states that this robot measures.
        axis: Name of the axis to be driven.

    Returns:
        A phrase for people, such as "it is in m, axis 'yaw' is in rad".
    """
    mine = next((a for a in spec.axes if a.name == axis), None)
    if mine is None:
        return f"the robot has no axis {axis!r}"
    if needs.robot_kind != spec.kind:
        return f"it was learned on a {needs.robot_kind}, this robot is a {spec.kind}"
    if axis not in needs.axes:
        return f"it was learned on {', '.join(needs.axes)}, not on axis {axis!r}"
    if mine.unit != needs.unit:
        return f"it is in {needs.unit}, axis {axis!r} is in {mine.unit}"
    if abs(needs.sample_time_s - spec.sample_time_s) > 1e-9 * spec.sample_time_s:
        return f"its sample time is {needs.sample_time_s:g} s, the robot's {spec.sample_time_s:g} s"
    if state_names[: len(needs.states)] != needs.states:
        return (
            f"it needs the states {', '.join(needs.states)}, the robot measures "
            f"{', '.join(state_names) or 'none'}"
        )
    return None
