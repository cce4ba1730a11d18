"""Flights in Parquet: a row per sample, files of some hundred flights each."""

import json
from collections.abc import Callable, Iterator
from itertools import batched
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq

from angler_mjx.learning.datasets.dataset import Dataset
from angler_mjx.learning.datasets.exports import flights
from angler_mjx.learning.datasets.exports.flights import ExportedFlight

FLIGHTS_PER_FILE = 500
"""Number of flights of a file."""


def write_dataset(data: Dataset, out: Path, action: str, progress: Callable[[int], None]) -> None:
    """Write all flights into a folder.

    Args:
        data: the dataset.
        out: empty folder.
        action: see `flights.ACTIONS`.
        progress: called with the number of written flights.

    Raises:
        ConfigError: the action is unknown, or a file is damaged.
        OSError: writing failed.
    """
    names = flights.action_names(data, action)
    schema = _build_schema(data, names, flights.describe_columns(data, action))
    n_written = 0
    for number, group in enumerate(
        batched(flights.iterate_flights(data, action), FLIGHTS_PER_FILE)
    ):
        with pq.ParquetWriter(out / f"part-{number:05d}.parquet", schema) as writer:
            for flight in group:
                writer.write_batch(_build_batch(flight, schema))
        n_written += len(group)
        progress(n_written)


def _build_schema(data: Dataset, actions: tuple[str, ...], about: dict[str, object]) -> pa.Schema:
    text = pa.dictionary(pa.int32(), pa.string())
    numbers = ["time_s", *flights.STATE_COLUMNS, *(f"action_{name}" for name in actions)]
    numbers += flights.other_names(data)
    fields = [
        pa.field("episode", pa.int64(), metadata={"unit": "1"}),
        pa.field("robot", pa.int32(), metadata={"unit": "1"}),
        pa.field("split", text),
        pa.field("outcome", text),
        *(
            pa.field(name, pa.float32(), metadata={"unit": flights.unit_of(name)})
            for name in numbers
        ),
    ]
    return pa.schema(fields, metadata={"angler": json.dumps(about)})


def _build_batch(flight: ExportedFlight, schema: pa.Schema) -> pa.RecordBatch:
    steps = len(flight.time_s)
    columns = list(_iterate_columns(flight, steps))
    return pa.record_batch(
        [
            pa.array(x, schema.field(i).type) if not isinstance(x, pa.Array) else x
            for i, x in enumerate(columns)
        ],
        schema=schema,
    )


def _iterate_columns(flight: ExportedFlight, steps: int) -> Iterator[object]:
    yield np.full(steps, flight.episode, np.int64)
    yield np.full(steps, flight.robot, np.int32)
    for text in (flight.split, flight.outcome):
        yield pa.DictionaryArray.from_arrays(pa.array(np.zeros(steps, np.int32)), [text])
    yield flight.time_s
    yield from flight.state.T
    yield from flight.action.T
    yield from flight.others.reshape(steps, -1).T
