"""Reads a recording back, as any other program would."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rerun.chunk import RrdReader

from nufleet.shared.arrays import FloatArray


def entities(path: Path) -> set[str]:
    """Return the paths of everything drawn, statically or over time."""
    return {str(chunk.entity_path) for chunk in RrdReader(path).stream().to_chunks()}


def column(path: Path, entity: str, component: str, timeline: str = "t") -> list[object]:
    """Return what was drawn in a component of an entity, over time."""
    values: list[tuple[float, object]] = []
    for chunk in RrdReader(path).stream().filter(content=entity, is_static=False).to_chunks():
        batch = chunk.to_record_batch()
        if component not in batch.schema.names or timeline not in batch.schema.names:
            continue
        times = batch[timeline].cast("int64").to_numpy(zero_copy_only=False)
        values += zip(times.tolist(), batch[component].to_pylist(), strict=True)
    return [value for _, value in sorted(values, key=lambda entry: entry[0])]


def scalars(path: Path, entity: str) -> tuple[FloatArray, FloatArray]:
    """Return times in seconds and values of a series, in the order of time."""
    times_ns, values = [], []
    for chunk in RrdReader(path).stream().filter(content=entity, is_static=False).to_chunks():
        batch = chunk.to_record_batch()
        if "Scalars:scalars" not in batch.schema.names:
            continue  # colours that change, or a break in the line
        times_ns.append(batch["t"].cast("int64").to_numpy(zero_copy_only=False))
        values.append(batch["Scalars:scalars"].flatten().to_numpy(zero_copy_only=False))
    all_ns, all_values = np.concatenate(times_ns), np.concatenate(values)
    order = np.argsort(all_ns, kind="stable")
    return all_ns[order] * 1e-9, all_values[order]


def layouts(path: Path) -> list[set[str]]:
    """Return the names of the views and containers of every layout that was sent, in order."""
    reader = RrdReader(path)
    found: list[tuple[int, set[str]]] = []
    for store in reader.blueprints():
        names: set[str] = set()
        sent_ns: list[int] = []
        for chunk in reader.stream(store=store).to_chunks():
            batch = chunk.to_record_batch()
            if "log_time" in batch.schema.names:
                sent_ns += batch["log_time"].cast("int64").to_pylist()
            for component in ("ViewBlueprint:display_name", "ContainerBlueprint:display_name"):
                if component in batch.schema.names:
                    names |= {name for row in batch[component].to_pylist() for name in row or ()}
        found.append((min(sent_ns), names))
    return [names for _, names in sorted(found, key=lambda entry: entry[0])]
