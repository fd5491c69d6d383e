"""What a frequency test plays: one or more tones between a ramp, settling and a measuring part."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from nufleet.shared.strict import Name, NonNegative, Positive, Strict


class Tone(Strict):
    """One sinusoid of an excitation: `weight` is its share relative to the other tones."""

    omega_rad_s: Positive
    weight: Positive = 1.0
    phase_rad: float = 0.0


class Excitation(Strict):
    """A request for a test. What is left out, the robot chooses under its own limits.

    `amplitude` is the peak of the whole reference in the axis's unit. The measuring part lasts
    `segments` segments of equal length; each holds at least one period of every tone and gives its
    own phasors, whose scatter is the measurement's uncertainty. `settle_s` precedes it.
    """

    kind: Literal["excitation"] = "excitation"
    axis: Name
    tones: Annotated[tuple[Tone, ...], Field(min_length=1, max_length=128)]
    amplitude: Positive | None = None
    segments: Annotated[int, Field(ge=3, le=64)] = 4
    segment_min_s: NonNegative = 0.0
    settle_s: NonNegative | None = None

    @model_validator(mode="after")
    def _tones_differ(self) -> Excitation:
        omegas = [tone.omega_rad_s for tone in self.tones]
        if len(set(omegas)) != len(omegas):
            raise ValueError("tones must have different frequencies")
        return self


class ExcitationPlan(Strict):
    """An excitation with everything chosen: what the robot plays, sample by sample.

    The reference is amplitude × envelope(k) × Σ weight_i sin(ω_i k T + phase_i) / peak of that sum;
    the envelope rises over `ramp_samples`, stays at 1 for `settle_samples` and then for
    `segments` × `segment_samples`, and falls over `ramp_samples`.
    """

    kind: Literal["excitation"] = "excitation"
    axis: Name
    tones: Annotated[tuple[Tone, ...], Field(min_length=1, max_length=128)]
    amplitude: Positive
    sample_time_s: Positive
    ramp_samples: Annotated[int, Field(ge=1)]
    settle_samples: Annotated[int, Field(ge=0)]
    segments: Annotated[int, Field(ge=3, le=64)]
    segment_samples: Annotated[int, Field(ge=4)]

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
        """How long the motion takes on the robot's clock."""
        return self.samples * self.sample_time_s
