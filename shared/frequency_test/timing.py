"""How regular the samples of a real robot's test were, and the findings that follow."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from pydantic import Field

from nufleet.shared.frequency_test.quality import Finding
from nufleet.shared.strict import NonNegative, Positive, Strict

JITTER_REPORTED = 0.05
"""Standard deviation of the samples' times, as a share of the sample time, that is reported."""

PERIOD_REPORTED = 1e-3
"""Relative error of the sample time that is reported: all frequencies are off by it."""


LATE_REPORTED = 1e-3
"""Share of the samples that began too late which is reported."""


class Timing(Strict):
    """Times at which a test's references were sent and its outputs measured."""

    period_s: Positive
    """Mean time between two references."""
    jitter_std_s: NonNegative
    """Standard deviation of the times of the references about a regular grid."""
    gap_max_s: NonNegative
    """Longest time between two measurements."""
    unmeasured: Annotated[float, Field(ge=0, le=1)]
    """Share of the samples without a measurement within one sample time, which were
    interpolated over a longer time."""
    clock_std_s: NonNegative = 0.0
    """Standard deviation of the error that the times of all measurements have in common."""


def timing_findings(timing: Timing, sample_time_s: float) -> Iterator[Finding]:
    """Yield warnings about irregular samples.

    Irregular times scatter the outputs, so the variance of the response accounts for them.

    Args:
        timing: Times of the samples.
        sample_time_s: Time that there should be between two samples.
    """
    if timing.jitter_std_s > JITTER_REPORTED * sample_time_s:
        yield Finding(
            code="jitter",
            text=f"the references were sent {1e3 * timing.jitter_std_s:.2g} ms (standard "
            f"deviation) off their times, {1e3 * sample_time_s:.3g} ms apart: give the agent's "
            "process a processor of its own",
        )
    off = timing.period_s / sample_time_s - 1
    if abs(off) > PERIOD_REPORTED:
        yield Finding(
            code="period",
            text=f"the samples were {1e3 * timing.period_s:.4g} ms apart instead of "
            f"{1e3 * sample_time_s:.4g} ms, so that all frequencies are {-100 * off:+.2g} % off",
        )
    if timing.unmeasured > 0:
        yield Finding(
            code="gaps",
            text=f"{100 * timing.unmeasured:.2g} % of the samples had no measurement within a "
            f"sample time; the longest gap was {1e3 * timing.gap_max_s:.3g} ms",
        )


def late_findings(late: int, samples: int) -> Iterator[Finding]:
    """Yield a warning about samples that began too late, if they are many.

    Args:
        late: Number of samples that began more than a sample time after their turn.
        samples: Number of all samples.
    """
    if late > LATE_REPORTED * samples:
        yield Finding(
            code="late",
            text=f"{late} of {samples} samples began more than a sample time late, because the "
            "agent's machine was busy: grant the agent real-time priority (deploy/systemd), or a "
            "machine of its own",
        )
