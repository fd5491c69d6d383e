"""The Parquet data set in a run's folder that holds every sample of every flight along a path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nufleet.orchestrator.flights.pilot import PathFlight
from nufleet.shared.arrays import FloatArray, arrow

if TYPE_CHECKING:
    import pyarrow

FLIGHTS = "flights.parquet"


class FlightTable:
    """Appends flights to the data set: a folder with one file for each flight.

    Readers of Parquet take the folder for one table. A file appears once it is complete, so that
    all flights until an interruption can be read, and a resumed run adds its own.
    """

    def __init__(self, folder: Path) -> None:
        self.path = folder / FLIGHTS

    def write(self, flight: PathFlight, axes: tuple[str, ...]) -> None:
        """Append a flight: one row for each sample and axis.

        Positions are in the unit of the axes; `prior`, `mean` and `variance` describe γ, in that
        unit per second (the variance in its square). `share` is the fraction of the correction that
        acted, in [0, 1]. `weights` holds the weight of every source in a mixture and of `none`, by
        name; it is null without a mixture.

        Args:
            flight: Flight to append.
            axes: Names of the robot's axes, in the order of the columns of the flight's arrays.
        """
        import pyarrow.parquet as pq

        pa = arrow()
        samples, details = len(flight.actual), flight.details
        if not samples:
            return

        def repeated(name: str) -> pyarrow.DictionaryArray:
            return pa.array([name] * samples, pa.string()).dictionary_encode()

        tables = []
        for column, axis in enumerate(axes):
            table = pa.table(
                {
                    "robot": repeated(flight.robot),
                    "flight": repeated(flight.label),
                    "axis": repeated(axis),
                    "sample": np.arange(samples, dtype=np.int32),
                    "t_s": np.arange(samples) * flight.sample_time_s,
                    "desired": details.desired[:, column],
                    "reference": flight.reference[:, column],
                    "actual": flight.actual[:, column],
                    "prior": details.prior[:, column],
                    "mean": details.mean[:, column],
                    "variance": details.variance[:, column],
                    "share": details.share,
                    "weights": _maps(flight.weights, samples),
                }
            )
            tables.append(table)
        self.path.mkdir(exist_ok=True)
        number = len(list(self.path.glob("*.parquet"))) + 1
        whole = self.path / f"{number:05d}.parquet"
        # Readers skip names that begin with an underscore.
        part = whole.with_name(f"_{whole.name}.part")
        pq.write_table(pa.concat_tables(tables), part, compression="zstd")
        part.rename(whole)


def _maps(weights: dict[str, FloatArray], samples: int) -> pyarrow.Array:
    """Return one map from name to weight for each sample, or as many nulls without weights."""
    pa = arrow()
    kind = pa.map_(pa.string(), pa.float64())
    if not weights:
        return pa.nulls(samples, kind)
    columns = np.stack(list(weights.values()), axis=1)
    rows = np.arange(samples + 1, dtype=np.int32) * len(weights)
    return pa.MapArray.from_arrays(
        rows, pa.array(list(weights) * samples, pa.string()), pa.array(columns.ravel())
    )
