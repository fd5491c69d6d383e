"""The reference of a frequency test: one or more tones, ramped up, held to settle, measured."""

from __future__ import annotations

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


class Excitation(Strict):
    """A request for a frequency test. The robot chooses omitted values within its own limits.

    The measuring part consists of segments of equal length, which together hold at least one period
    of every tone. Each yields its own phasors, whose scatter measures the uncertainty.
    """

    kind: Literal["excitation"] = "excitation"
    """Discriminator among the motions a robot can be asked for."""
    axis: Name
    """Name of the axis whose reference is excited."""
    tones: Annotated[tuple[Tone, ...], Field(min_length=1, max_length=128)]
    """Tones to play at once; their frequencies differ."""
    amplitude: Positive | None = None
    """Peak of the whole reference, in the axis's unit."""
    segments: Annotated[int, Field(ge=3, le=64)] = 4
    """Number of segments of the measuring part."""
    segment_min_s: NonNegative = 0.0
    """Shortest allowed duration of a segment."""
    settle_s: NonNegative | None = None
    """Time between the ramp and the measuring part."""

    @model_validator(mode="after")
    def _tones_differ(self) -> Excitation:
        omegas = [tone.omega_rad_s for tone in self.tones]
        if len(set(omegas)) != len(omegas):
            raise ValueError("tones must have different frequencies")
        return self


class ExcitationPlan(Strict):
    """A complete excitation, which determines every sample of the robot's reference.

    The reference is amplitude × envelope(k) × Σ weight_i sin(ω_i k T + phase_i) / peak of that sum,
    with T = `sample_time_s`. The envelope rises over `ramp_samples`, stays at 1 for
    `settle_samples` and then for `segments` × `segment_samples`, and falls over `ramp_samples`.
    """

    kind: Literal["excitation"] = "excitation"
    """Discriminator among the plans of motions."""
    axis: Name
    """Name of the axis whose reference is excited."""
    tones: Annotated[tuple[Tone, ...], Field(min_length=1, max_length=128)]
    """Tones played at once."""
    amplitude: Positive
    """Peak of the whole reference, in the axis's unit."""
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
