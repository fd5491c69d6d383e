"""The Parquet file in a run's folder that holds every sample of every flight along a path."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from nufleet.orchestrator.flights.pilot import PathFlight
from nufleet.shared.arrays import FloatArray, arrow

if TYPE_CHECKING:
    import pyarrow
    import pyarrow.parquet

FLIGHTS = "flights.parquet"


class FlightTable:
    """Appends flights to the file; only closing it, or leaving its context, completes the file."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / FLIGHTS
        self._writer: pyarrow.parquet.ParquetWriter | None = None

    def __enter__(self) -> FlightTable:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Complete the file."""
        writer, self._writer = self._writer, None
        if writer is not None:
            writer.close()

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

        def repeated(name: str) -> pyarrow.DictionaryArray:
            # The type is given explicitly: a flight may have no samples to infer it from.
            return pa.array([name] * samples, pa.string()).dictionary_encode()

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
            if self._writer is None:
                self._writer = pq.ParquetWriter(self.path, table.schema, compression="zstd")
            self._writer.write_table(table)


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
