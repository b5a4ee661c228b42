"""Rerun recordings read back."""

from collections import defaultdict
from pathlib import Path

import numpy as np

Columns = dict[str, dict[str, list[object]]]


def read_back(path: Path, *, blueprint: bool = False) -> Columns:
    """Entity -> column without its archetype -> one value a row; times in nanoseconds."""
    import rerun as rr

    reader = rr.chunk.RrdReader(str(path))
    (store,) = reader.blueprints() if blueprint else reader.recordings()
    entities: Columns = defaultdict(lambda: defaultdict(list))
    for chunk in reader.stream(store=store).to_chunks():
        batch = chunk.to_record_batch()
        for name, values in zip(batch.schema.names, batch.columns, strict=True):
            is_time = str(values.type).startswith(("timestamp", "duration"))
            rows = values.cast("int64") if is_time else values
            entities[chunk.entity_path][name.split(":")[-1]] += rows.to_pylist()
    return entities


def array(values: object) -> np.ndarray:
    return np.array(values, dtype=np.float64)
