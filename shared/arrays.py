"""The two array types that pass between modules, and the library that stores arrays as columns."""

from __future__ import annotations

import sys
from importlib.abc import MetaPathFinder
from types import ModuleType

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]


class _NoPandas(MetaPathFinder):
    """Finds that pandas is not installed."""

    def find_spec(self, name: str, *_: object) -> None:
        """Raise ModuleNotFoundError for pandas; find nothing else."""
        if name == "pandas":
            raise ModuleNotFoundError(name)


def arrow() -> ModuleType:
    """Return pyarrow, which does not load pandas.

    If pandas is installed, pyarrow loads it at the first array, only to ask whether that array is
    one of pandas's; this takes a third of a second. A program that has loaded pandas keeps it, and
    one that loads it later can.
    """
    import pyarrow

    hidden = _NoPandas()
    sys.meta_path.insert(0, hidden)
    try:
        pyarrow.array([0])  # it asks once
    finally:
        sys.meta_path.remove(hidden)
    return pyarrow  # type: ignore[no-any-return]
