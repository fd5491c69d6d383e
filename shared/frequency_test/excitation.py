"""The reference of a frequency test: tones on one or more axes, ramped up, settled, measured."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.strict import Name, NonNegative, Positive, Strict


class Tone(Strict):
    """One sinusoid of an excitation, weight × sin(ω t + phase)."""

    omega_rad_s: Positive
    """Angular frequency ω."""
    weight: Positive = 1.0
    """Amplitude relative to the other tones."""
    phase_rad: float = 0.0
    """Phase at the beginning of the motion."""


class AxisTones(Strict):
    """The tones of one axis in a request for a frequency test."""

    axis: Name
    """Name of the axis whose reference is excited."""
    tones: Annotated[tuple[Tone, ...], Field(min_length=1, max_length=128)]
    """Tones to play at once; their frequencies differ."""
    amplitude: Positive | None = None
    """Peak of the axis's whole reference, in its unit."""


class Excitation(AxisTones):
    """A request for a frequency test. The robot chooses omitted values within its own limits.

    The measuring part consists of segments of equal length, which together hold at least one period
    of every tone. Each yields its own phasors, whose scatter measures the uncertainty.
    """

    kind: Literal["excitation"] = "excitation"
    """Discriminator among the motions a robot can be asked for."""
    also: Annotated[tuple[AxisTones, ...], Field(max_length=15)] = ()
    """Further axes that play at the same time, each at frequencies of its own."""
    segments: Annotated[int, Field(ge=3, le=64)] = 4
    """Number of segments of the measuring part."""
    segment_min_s: NonNegative = 0.0
    """Shortest allowed duration of a segment."""
    settle_s: NonNegative | None = None
    """Time between the ramp and the measuring part."""

    @property
    def played(self) -> tuple[AxisTones, ...]:
        """The tones of every axis that plays, the first axis first."""
        return (self, *self.also)

    @property
    def omega_rad_s(self) -> tuple[float, ...]:
        """Frequencies of all axes' tones, rising."""
        return tuple(sorted(tone.omega_rad_s for one in self.played for tone in one.tones))

    @model_validator(mode="after")
    def _tones_differ(self) -> Excitation:
        _check_distinct(self.played)
        if len({one.amplitude is None for one in self.played}) > 1:
            raise ValueError("the amplitudes of all axes are requested, or of none")
        return self


class PlannedTones(Strict):
    """The tones of one axis in a planned frequency test."""

    axis: Name
    """Name of the axis whose reference is excited."""
    tones: Annotated[tuple[Tone, ...], Field(min_length=1, max_length=128)]
    """Tones played at once."""
    amplitude: Positive
    """Peak of the axis's whole reference, in its unit."""


class ExcitationPlan(PlannedTones):
    """A complete excitation, which determines every sample of the robot's reference.

    The reference of each axis is its amplitude × envelope(k) × Σ weight_i sin(ω_i k T + phase_i) /
    peak of that sum, with T = `sample_time_s`. The envelope, the same for all axes, rises over
    `ramp_samples`, stays at 1 for `settle_samples` and then for `segments` × `segment_samples`, and
    falls over `ramp_samples`.
    """

    kind: Literal["excitation"] = "excitation"
    """Discriminator among the plans of motions."""
    also: Annotated[tuple[PlannedTones, ...], Field(max_length=15)] = ()
    """Further axes that play at the same time."""
    sample_time_s: Positive
    """Time between samples, T."""
    ramp_samples: Annotated[int, Field(ge=1)]
    """Number of samples of each ramp, at the beginning and at the end."""
    settle_samples: Annotated[int, Field(ge=0)]
    """Number of samples between the first ramp and the measuring part."""
    segments: Annotated[int, Field(ge=3, le=64)]
    """Number of segments of the measuring part."""
    segment_samples: Annotated[int, Field(ge=4)]
    """Number of samples of one segment."""

    @property
    def played(self) -> tuple[PlannedTones, ...]:
        """The tones of every axis that plays, the first axis first."""
        return (self, *self.also)

    @property
    def columns(self) -> tuple[int, ...]:
        """Shape of one sample: () for one axis, (axes,) for several."""
        return (len(self.played),) if self.also else ()

    @property
    def first_measured_sample(self) -> int:
        """Index of the first sample of the measuring part."""
        return self.ramp_samples + self.settle_samples

    @property
    def samples(self) -> int:
        """Number of samples of the whole reference."""
        return self.first_measured_sample + self.segments * self.segment_samples + self.ramp_samples

    @property
    def duration_s(self) -> float:
        """Duration of the motion on the robot's clock."""
        return self.samples * self.sample_time_s

    @model_validator(mode="after")
    def _tones_differ(self) -> ExcitationPlan:
        _check_distinct(self.played)
        return self


def _check_distinct(played: Sequence[AxisTones] | Sequence[PlannedTones]) -> None:
    """Raise ValueError if an axis or a frequency occurs twice.

    The response to a tone can be assigned to an axis only if no other axis plays it.
    """
    axes = [one.axis for one in played]
    if len(set(axes)) != len(axes):
        raise ValueError(f"an axis plays once in a test, got {', '.join(axes)}")
    omegas = [tone.omega_rad_s for one in played for tone in one.tones]
    if len(set(omegas)) != len(omegas):
        raise ValueError("tones must have different frequencies")
