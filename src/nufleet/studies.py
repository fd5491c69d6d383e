"""For authors of algorithms: what a study is asked, and what it answers.

A package registers its algorithms under the entry-point group `nufleet.studies`: each is a class,
or a function, that is called with a `StudyPlan`, the spec of each robot by name, and a NumPy
generator, and returns a `Study`. `nufleet rank --algorithm NAME` then conducts it on the robots,
stores its tests, and resumes it after an interruption: so it must ask the same questions when it is
built again from the same arguments and is told the same answers.

>>> import numpy as np
>>> plan = StudyPlan(
...     target="a", sources=("b", "c"), band_rad_s=(0.5, 8.0), iterations=3, axis="x"
... )
>>> test = Excitation(axis=plan.axis, tones=(Tone(omega_rad_s=2.0), Tone(omega_rad_s=5.0)))
>>> Question(1, dict.fromkeys(("a", *plan.sources), test)).omega_rad_s
(2.0, 5.0)
>>> chordal_distance(np.array([1.0 + 0j]), np.array([0.5 + 0j]))
array([0.31622777])
"""

from __future__ import annotations

from nufleet.orchestrator.study.interface import (
    Curve,
    Question,
    Report,
    SourceEstimate,
    Study,
    StudyPlan,
)
from nufleet.shared.distance.chordal import chordal_distance, chordal_variance
from nufleet.shared.errors import StudyError
from nufleet.shared.frequency_test.excitation import Excitation, Tone
from nufleet.shared.frequency_test.frequency_response import FrequencyResponse

__all__ = [
    "Curve",
    "Excitation",
    "FrequencyResponse",
    "Question",
    "Report",
    "SourceEstimate",
    "Study",
    "StudyError",
    "StudyPlan",
    "Tone",
    "chordal_distance",
    "chordal_variance",
]
