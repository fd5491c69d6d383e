"""What an import found, as the document that other programs read and as lines for people."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict
from typing import Annotated

from pydantic import Field

from nufleet.orchestrator.logs.alignment import Timing
from nufleet.orchestrator.logs.signals import Channel
from nufleet.shared.frequency_test.quality import Finding
from nufleet.shared.strict import Document, Identifier, NonNegative, Positive, Strict

Count = Annotated[int, Field(ge=0)]


class SignalReport(Strict):
    """How a signal was sampled in its log."""

    name: str
    """Name of the signal."""
    samples: Count
    """Number of samples that were used."""
    interval_s: Positive
    """Median time between samples."""
    jitter_s: NonNegative
    """Standard deviation of that time."""
    gaps: Count
    """Number of gaps, at which the record is cut."""
    disordered: Count
    """Number of samples whose time stamp steps back, which were left out."""

    @staticmethod
    def of(name: str, timing: Timing) -> SignalReport:
        """Return the report on a signal."""
        return SignalReport(name=name, **asdict(timing))


class ImportResult(Document):
    """The document that `nufleet import --json` prints."""

    fleet: str
    """Name of the fleet."""
    robot: str
    """Name of the robot."""
    axis: str
    """Name of the axis."""
    response: Identifier
    """Id of the stored response."""
    new: bool
    """Whether it was stored now; false if this flight is known already."""
    measured_at: str
    """Time of the flight, in ISO 8601 and UTC: by its time stamps, else that of the file."""
    duration_s: Positive
    """Duration of what was used, without gaps."""
    band_rad_s: tuple[float, float]
    """Lowest and highest frequency in rad/s at which the response is known."""
    frequencies: Count
    """Number of frequencies at which it is."""
    speed: NonNegative
    """Largest speed of the reference, in the axis's unit per second."""
    amplitude: NonNegative
    """Half the range of the reference, in the axis's unit."""
    noise_std: NonNegative
    """Standard deviation of one sample's noise, in the axis's unit."""
    delay_std_s: NonNegative
    """What the time stamps leave open of the delay from reference to output."""
    reference: SignalReport
    """How the reference was sampled."""
    output: SignalReport
    """How the output was sampled."""
    findings: tuple[Finding, ...]
    """Observations that weaken the response."""

    def lines(self, unit: str) -> Iterator[str]:
        """Yield the result in lines for people; `unit` is the axis's unit."""
        low, high = self.band_rad_s
        for name, one in (("reference", self.reference), ("output", self.output)):
            jitter_ms = round(1e3 * one.jitter_s, 3)  # what rounding leaves of time stamps is none
            yield (
                f"{name}: {one.name}, {one.samples} samples, every {1e3 * one.interval_s:.3g} ms ± "
                f"{jitter_ms:.2g} ms, {one.gaps} gaps, {one.disordered} out of order"
            )
        yield (
            f"{self.robot}, axis {self.axis}: {self.duration_s:.1f} s at up to "
            f"{self.speed:.2g} {unit}/s and ±{self.amplitude:.2g} {unit}, noise "
            f"{1e3 * self.noise_std:.2g} m{unit}"
        )
        yield (
            f"its response is known at {self.frequencies} frequencies from {low:.3g} to "
            f"{high:.3g} rad/s"
        )
        for finding in self.findings:
            yield f"[yellow]{finding}[/]"
        yield (
            f"stored as {self.response}: `nufleet rank --reuse` counts it as evidence"
            if self.new
            else f"this flight is stored already, as {self.response}"
        )


class ListResult(Document):
    """The document that `nufleet import --list --json` prints."""

    signals: tuple[Channel, ...]
    """Signals that the log offers."""
