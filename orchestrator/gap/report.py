"""The result of `nufleet gap`, for programs and for people."""

from __future__ import annotations

import math
from pathlib import Path

from rich.markup import escape
from rich.table import Table

from nufleet.orchestrator.gap.measured_response import MeasuredResponse, band_distance
from nufleet.orchestrator.gap.model_files import ModelFileError, read_model
from nufleet.shared.distance.nu_gap import ComputedFrom, NuGap, chordal_peak_in_band, nu_gap
from nufleet.shared.distance.rational_gap import rational_nu_gap
from nufleet.shared.distance.stability_margin import stability_guarantee, stability_margin
from nufleet.shared.models.realization import TransferFunction
from nufleet.shared.models.transfer_models import StateSpace
from nufleet.shared.strict import Document, Strict


class WindingCondition(Strict):
    """The winding condition wno det(I + P₂*P₁) + η(P₁) − η(P₂) − η₀(P₂) = 0, term by term."""

    holds: bool
    """Whether the condition holds."""
    winding_number: int | None
    """Winding number wno det(I + P₂*P₁); None where the determinant is 0 at some frequency."""
    poles_unstable: tuple[int, int]
    """Numbers of unstable poles η(P₁) and η(P₂)."""
    poles_on_axis: tuple[int, int]
    """Numbers of poles on the stability boundary, η₀(P₁) and η₀(P₂)."""
    reason: str
    """Explanation for people."""


class BandReport(Strict):
    """The band in which the largest chordal distance was found, and the certainty of the result."""

    band_rad_s: tuple[float, float]
    """Compared band in rad/s: the measured part of the requested one."""
    band_asked_rad_s: tuple[float, float] | None
    """Requested band in rad/s; None if there was none."""
    omega_max_rad_s: float
    """Frequency of the largest distance in rad/s."""
    standard_deviation: float | None
    """Standard deviation of the distance where responses are measured; None otherwise."""


class ControllerReport(Strict):
    """The stability margins of both loops, and the guarantee that the ν-gap alone gives."""

    controller: str
    """File of the controller."""
    margin_first: float
    """Margin b_{P₁,C} of the loop with the first model."""
    margin_second: float
    """Margin b_{P₂,C} of the loop with the second model."""
    guaranteed: bool
    """Whether the ν-gap alone guarantees that the second loop is stable."""
    margin_second_at_least: float
    """Lower bound of the second margin that follows from the ν-gap."""


class GapReport(Document):
    """The document of `nufleet gap --json`.

    A frequency is null where it is infinite. `nu_gap` is null where a response was measured: there
    is then no ν-gap, only `chordal_max_in_band`.
    """

    first: str
    """File of the first model or response."""
    second: str
    """File of the second model or response."""
    nu_gap: float | None = None
    """ν-gap δ_ν of two models, from 0 to 1."""
    chordal_peak: float | None = None
    """Largest chordal distance of two models over all frequencies."""
    omega_peak_rad_s: float | None = None
    """Frequency of that distance in rad/s."""
    winding_condition: WindingCondition | None = None
    """Winding condition of two models."""
    computed_from: ComputedFrom | None = None
    """Representation that the ν-gap was computed from: the polynomials of two transfer functions,
    or the matrices of two state-space models."""
    guarantee: str | None = None
    """Guarantee that the ν-gap gives, in words."""
    chordal_max_in_band: float | None = None
    """Largest chordal distance in the band."""
    band: BandReport | None = None
    """Band that was compared, if any."""
    controller: ControllerReport | None = None
    """Margins with the controller, if one was given."""


def gap_report(
    first: Path, second: Path, band_rad_s: tuple[float, float] | None, controller: Path | None
) -> GapReport:
    """Read two files and compare their models or responses.

    Args:
        first: File of the first model or response.
        second: File of the second model or response.
        band_rad_s: Band to compare, in rad/s; None compares a measured response over all of its
            frequencies that both have, and two models by their ν-gap only.
        controller: File of a controller whose loops are examined, if any.

    Raises:
        InvalidInputError: A file cannot be used, the models cannot be compared, the band is empty,
            or a controller is given together with a measured response.
    """
    p1, p2 = read_model(first), read_model(second)
    if isinstance(p1, MeasuredResponse) or isinstance(p2, MeasuredResponse):
        if controller is not None:
            raise ModelFileError(
                f"{first if isinstance(p1, MeasuredResponse) else second}: a measured response has"
                " no ν-gap, so nothing follows for a controller; give a model instead"
            )
        found = band_distance(p1, p2, band_rad_s)
        band = BandReport(
            band_rad_s=found.band_rad_s,
            band_asked_rad_s=band_rad_s,
            omega_max_rad_s=found.omega_rad_s,
            standard_deviation=found.standard_deviation,
        )
        return GapReport(
            first=str(first), second=str(second), chordal_max_in_band=found.value, band=band
        )
    gap = _nu_gap(p1, p2)
    in_band = None if band_rad_s is None else chordal_peak_in_band(p1, p2, band_rad_s)
    return GapReport(
        first=str(first),
        second=str(second),
        nu_gap=gap.value,
        chordal_peak=gap.chordal_peak,
        omega_peak_rad_s=gap.omega_peak_rad_s if math.isfinite(gap.omega_peak_rad_s) else None,
        winding_condition=WindingCondition(
            holds=gap.winding_ok,
            winding_number=gap.winding_number,
            poles_unstable=gap.poles_unstable,
            poles_on_axis=gap.poles_on_axis,
            reason=gap.reason,
        ),
        computed_from=gap.computed_from,
        guarantee=gap.guarantee,
        chordal_max_in_band=None if in_band is None else in_band.value,
        band=None
        if in_band is None or band_rad_s is None
        else BandReport(
            band_rad_s=band_rad_s,
            band_asked_rad_s=band_rad_s,
            omega_max_rad_s=in_band.omega_rad_s,
            standard_deviation=None,
        ),
        controller=None if controller is None else _controller_report(p1, p2, gap, controller),
    )


def _nu_gap(first: StateSpace, second: StateSpace) -> NuGap:
    """Return the ν-gap, from the polynomials themselves if both models are transfer functions."""
    if (
        isinstance(first, TransferFunction)
        and isinstance(second, TransferFunction)
        and first.dt_s == second.dt_s
    ):
        return rational_nu_gap(first.num, first.den, second.num, second.den, first.dt_s)
    return nu_gap(first, second)


def gap_table(report: GapReport) -> Table:
    """Return the report as a table of two columns."""
    title = escape(f"{report.first} and {report.second}")
    table = Table(title=title, title_justify="left", show_header=False)
    if report.nu_gap is not None and report.winding_condition is not None:
        table.add_row("ν-gap", f"{report.nu_gap:.6f}", style="bold")
        omega = (
            "ω → ∞" if report.omega_peak_rad_s is None else f"{report.omega_peak_rad_s:.6g} rad/s"
        )
        table.add_row("largest chordal distance", f"{report.chordal_peak:.6f} at {omega}")
        table.add_row("why", report.winding_condition.reason)
        table.add_row("guarantee", report.guarantee)
        table.add_row("computed from", f"the {report.computed_from} of both models")
    else:
        table.add_row("ν-gap", "unknown: it needs models, and at least one response was measured")
    if report.band is not None:
        deviation = report.band.standard_deviation
        spread = f" ± {deviation:.2g}" if deviation else ""
        if report.band.band_asked_rad_s not in (None, report.band.band_rad_s):
            asked = "{:.6g} to {:.6g}".format(*report.band.band_asked_rad_s)
            table.add_row("not the whole band", f"only a part of {asked} rad/s was measured")
        table.add_row(
            f"largest chordal distance from {report.band.band_rad_s[0]:.6g}"
            f" to {report.band.band_rad_s[1]:.6g} rad/s",
            f"{report.chordal_max_in_band:.6f}{spread} at {report.band.omega_max_rad_s:.6g} rad/s"
            " (a lower bound of the ν-gap)",
        )
    if report.controller is not None:
        _add_controller(table, report.controller)
    return table


def _add_controller(table: Table, found: ControllerReport) -> None:
    for ordinal, margin in (("first", found.margin_first), ("second", found.margin_second)):
        said = f"{margin:.6f}" if margin > 0 else "0: it does not stabilise it"
        table.add_row(escape(f"margin of {found.controller} with the {ordinal}"), said)
    table.add_row(
        "the ν-gap alone guarantees",
        f"a margin of at least {found.margin_second_at_least:.6f} with the second"
        if found.guaranteed
        else "no margin: it is not below the margin with the first",
    )


def _controller_report(
    first: StateSpace, second: StateSpace, gap: NuGap, path: Path
) -> ControllerReport:
    controller = read_model(path)
    if isinstance(controller, MeasuredResponse):
        raise ModelFileError(f"{path}: a controller must be a model, not a measured response")
    margins = [stability_margin(plant, controller).value for plant in (first, second)]
    promise = stability_guarantee(margins[0], gap.value)
    return ControllerReport(
        controller=str(path),
        margin_first=margins[0],
        margin_second=margins[1],
        guaranteed=promise.holds,
        margin_second_at_least=promise.margin_at_least,
    )
