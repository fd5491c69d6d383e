"""The response of one axis of a robot from a log, or from a flight of nufleet's own."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from nufleet.orchestrator.flights.pilot import PathFlight
from nufleet.orchestrator.logs.alignment import Aligned
from nufleet.orchestrator.logs.signals import Signal
from nufleet.shared.frequency_test.quality import Finding, Quality
from nufleet.shared.frequency_test.record_response import (
    RecordResponse,
    Stretch,
    estimate_record_response,
)
from nufleet.shared.frequency_test.sensor_faults import sensor_faults
from nufleet.shared.robots.spec import RobotSpec

BAND_SHARE = 1 / 8
"""Highest frequency to estimate, as a share of the sampling rate: above it lies the noise that the
estimate is compared with."""


def response_of_log(
    reference: Signal, output: Signal, aligned: Aligned, spec: RobotSpec
) -> RecordResponse:
    """Estimate the response of one axis from a log.

    Args:
        reference: Positions that the robot was sent, as logged.
        output: Positions that were measured, as logged.
        aligned: Both at the robot's sample times.
        spec: Spec of the robot.

    Returns:
        The response; its verdict also names what the samples show of the sensor and the clocks.
    """
    low, high = _band(spec)
    record = estimate_record_response(
        aligned.stretches,
        spec.sample_time_s,
        (low, max(min(high, aligned.omega_max_rad_s), 2 * low)),
        spec.settling_time_s,
        delay_std_s=aligned.delay_std_s,
    )
    # Interpolated samples never repeat, so what is stuck or cut off shows in the log's own alone.
    first, last = (float(part) for part in (reference.time_s[0], reference.time_s[-1]))
    both = (output.time_s >= first) & (output.time_s <= last)
    moved = np.interp(output.time_s[both], reference.time_s, reference.value)
    faults = list(sensor_faults(output.value[both], moved, 1.0)) if np.any(both) else []
    warnings = []
    for name, timing in ((reference.name, aligned.reference), (output.name, aligned.output)):
        if timing.gaps or timing.disordered:
            warnings.append(
                Finding(
                    code="gaps",
                    text=f"{name}: {timing.gaps} gaps, {timing.disordered} samples out of order",
                )
            )
        if timing.jitter_s > 0.25 * timing.interval_s:
            warnings.append(
                Finding(
                    code="jitter",
                    text=f"{name}: its samples come every {1e3 * timing.interval_s:.3g} ms ± "
                    f"{1e3 * timing.jitter_s:.2g} ms",
                )
            )
    return _with_findings(record, faults, warnings)


def responses_of_flight(flight: PathFlight, spec: RobotSpec) -> dict[str, RecordResponse]:
    """Estimate the responses that a flight along a path gave, on every axis that it moved.

    Args:
        flight: A flight, finished or not; with an inverse, its reference is what that sent.
        spec: Spec of the robot that flew.

    Returns:
        One response for each axis whose reference moved, by axis; unusable ones say why.
    """
    found = {}
    for n, axis in enumerate(spec.axes):
        reference, output = flight.reference[:, n], flight.actual[:, n]
        if len(reference) < 4 or np.ptp(reference) == 0:
            continue
        record = estimate_record_response(
            [Stretch(reference, output)], spec.sample_time_s, _band(spec), spec.settling_time_s
        )
        faults = list(sensor_faults(output, reference, 1.0))
        found[axis.name] = _with_findings(record, faults, [])
    return found


def _band(spec: RobotSpec) -> tuple[float, float]:
    sampling_rad_s = 2 * math.pi / spec.sample_time_s
    return spec.omega_min_rad_s, min(spec.omega_max_rad_s, BAND_SHARE * sampling_rad_s)


def _with_findings(
    record: RecordResponse, reasons: Sequence[Finding], warnings: Sequence[Finding]
) -> RecordResponse:
    quality = record.response.quality
    more = Quality(reasons=(*quality.reasons, *reasons), warnings=(*quality.warnings, *warnings))
    return replace(record, response=replace(record.response, quality=more))
