"""What of a path is unlike all motions from which a robot knows itself.

A prediction holds for motions of the size and the frequencies that its model rests on. Beyond them
friction, drag and limits may show, or a response that was never measured.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.fft import rfft, rfftfreq

from nufleet.robot_agent.flight.own_model import OwnModel
from nufleet.shared.arrays import FloatArray
from nufleet.shared.models.error_belief import ErrorBelief
from nufleet.shared.robots.spec import AxisSpec
from nufleet.shared.text import in_thousandths

LARGER = 2.0
"""Size of a path's motion, as a multiple of the largest that an axis was seen in, from which on it
is mentioned."""

OUTSIDE = 0.05
"""Share of a path's mean square speed at frequencies of unknown response, from which on it is
mentioned."""

_UNKNOWN = 0.3  # standard deviation of a response, as a share of it, from which on it is unknown

REMEDY = "a rich flight shows it, such as that of `nufleet track --rich-flight 15`"


def unseen(model: OwnModel, axes: Sequence[AxisSpec], desired: FloatArray) -> str:
    """Return what of a path the robot has seen nothing like yet, and the remedy; empty if nothing.

    Args:
        model: The robot's model of itself.
        axes: Descriptions of its axes, in the order of the model.
        desired: Path, shape (samples, axes), in the axes' units.
    """
    never, smaller, found = list[str](), list[str](), list[str]()
    for i, (axis, belief) in enumerate(zip(axes, model.axes, strict=True)):
        if np.ptp(desired[:, i]) == 0:
            continue
        if belief.flown_s == 0:
            never.append(axis.name)
            continue
        size = float(np.std(desired[:, i]))
        if size > LARGER * belief.largest:
            before, now = (in_thousandths(value, axis.unit) for value in (belief.largest, size))
            smaller.append(f"{axis.name} {before} RMS instead of {now}")
        unknown, middle_rad_s = _unknown(belief, desired[:, i])
        if unknown > OUTSIDE:
            found.append(
                f"{100 * unknown:.0f} % of this path's motion along {axis.name}, around "
                f"{middle_rad_s:.2g} rad/s, is at frequencies at which its response is not known"
            )
    if never:
        found.append(f"it has never moved {' or '.join(never)}")
    if smaller:
        found.append(
            f"its motions until now were smaller than this path ({', '.join(smaller)}), so that "
            "what only larger ones show, such as friction and drag, is not foreseen"
        )
    return f"{'; '.join(found)}: {REMEDY}" if found else ""


def _unknown(belief: ErrorBelief, wanted: FloatArray) -> tuple[float, float]:
    """Return the share of a motion at frequencies of unknown response, and their mean in rad/s."""
    speed = np.diff(wanted)
    power = np.abs(rfft(speed)[1:]) ** 2
    omega_rad_s = 2 * np.pi * rfftfreq(len(speed), belief.basis.sample_time_s)[1:]
    z, variance = belief.response(np.asarray(omega_rad_s, dtype=np.float64))
    # The error of the baseline is a share |1 − z| of the motion; an inverse has to know z itself.
    matters = np.minimum(np.abs(z), np.abs(1 - z))
    unknown = np.where(variance > (_UNKNOWN * matters) ** 2, power, 0.0)
    share = float(unknown.sum() / power.sum())
    return share, float(unknown @ omega_rad_s / unknown.sum()) if share else 0.0
