"""What an inverse model says of itself: where it comes from, what it takes and gives."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.experience.layout import InverseLayout
from nufleet.shared.robots.spec import RobotSpec
from nufleet.shared.strict import Digest, Name, NonNegative, Positive, Strict

_Numbers = Annotated[tuple[float, ...], Field(min_length=1, max_length=64)]
_Scales = Annotated[tuple[Positive, ...], Field(min_length=1, max_length=64)]


class ExperienceManifest(Strict):
    """What an inverse model was learned from and what it may be used for.

    `axes` are those whose flights it learned; they share `unit`. `hidden` are the widths of the
    hidden layers; without any the model is linear. Inputs are (ξ − input_mean) / input_scale; the
    network's output times `output_scale` plus `output_mean` is γ in unit/s. `validation_rms` is the
    error of γ on points held back, in unit/s.
    """

    schema_version: Literal[1] = 1
    robot: Name
    robot_kind: Name
    axes: Annotated[tuple[Name, ...], Field(min_length=1, max_length=16)]
    unit: Literal["m", "rad"]
    layout: InverseLayout
    inputs: Annotated[tuple[str, ...], Field(min_length=1, max_length=64)]
    output: Literal["reference-speed"] = "reference-speed"
    relative_degree: Annotated[int, Field(ge=1, le=1000)]
    hidden: Annotated[tuple[Annotated[int, Field(ge=1, le=256)], ...], Field(max_length=8)] = (
        128,
        128,
        128,
        128,
    )
    input_mean: _Numbers
    input_scale: _Scales
    output_mean: float
    output_scale: Positive
    points: Annotated[int, Field(ge=1)]
    validation_rms: NonNegative
    data_sha256: Digest
    seed: Annotated[int, Field(ge=0)]
    training_version: Annotated[str, Field(max_length=100)]

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
        """The name and shape of every array of the network; a weight maps rows to columns."""
        widths = (len(self.inputs), *self.hidden, 1)
        shapes: dict[str, tuple[int, ...]] = {}
        for layer, (before, after) in enumerate(pairwise(widths)):
            shapes[f"weight_{layer}"] = (before, after)
            shapes[f"bias_{layer}"] = (after,)
        return shapes


@dataclass(frozen=True)
class Needs:
    """What an experience needs of a robot: its kind, axes and their unit, sample time, states."""

    robot_kind: str
    axes: tuple[str, ...]
    unit: str
    sample_time_s: float
    states: tuple[str, ...]


def needs_of(manifest: ExperienceManifest) -> Needs:
    """Return what a robot has to have to fly with an experience."""
    layout = manifest.layout
    return Needs(
        robot_kind=manifest.robot_kind,
        axes=manifest.axes,
        unit=manifest.unit,
        sample_time_s=layout.sample_time_s,
        states=layout.states if layout.architecture == "state" else layout.states[:1],
    )


def misfit(
    manifest: ExperienceManifest, spec: RobotSpec, state_names: tuple[str, ...], axis: str
) -> str | None:
    """Return why an experience cannot serve an axis of a robot; None when it can.

    Args:
        manifest: of the experience.
        spec: of the robot that would use it.
        state_names: what that robot's `observe` measures.
        axis: the axis to be driven.
    """
    return unmet(needs_of(manifest), spec, state_names, axis)


def unmet(needs: Needs, spec: RobotSpec, state_names: tuple[str, ...], axis: str) -> str | None:
    """Return which need an axis of a robot does not meet; None when it meets all."""
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
