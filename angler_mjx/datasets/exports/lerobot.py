"""Flights as a LeRobot dataset, version 3.0: an episode a robot's flight, without pictures.

Episodes lie split by split, so that ``splits`` of ``info.json`` are ranges. Whoever reads it needs
LeRobot; writing takes Parquet and JSON alone.
"""

import json
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from angler_mjx.datasets.exports import flights
from angler_mjx.datasets.exports.flights import Flight
from angler_mjx.datasets.reading.dataset import Dataset
from angler_mjx.errors import ConfigError
from angler_mjx.storage import folder

VERSION = "v3.0"
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
CHUNK = 1000
"""Files of a folder."""
FRAMES = 500_000
"""Of a data file."""
PLACES = 100_000
"""Episodes of a file of episodes."""

_COUNTED = ("frame_index", "episode_index", "index", "task_index")


def write(data: Dataset, out: Path, action: str, tell: Callable[[int], None]) -> None:
    """Write a LeRobot dataset; arguments and errors as of `parquet.write`.

    Raises:
        ConfigError: the recording rate is no whole number, which LeRobot asks for.
    """
    hz = data.run(int(data.index["part"][0].as_py())).scenario.time.record_hz
    if hz != int(hz):
        raise ConfigError(f"record_hz = {hz:g}: LeRobot takes whole numbers of frames a second")
    names = flights.action_names(data, action)
    made = _Writing(out, data, names)
    tell_at = 0
    for split in sorted(set(data.index["split"].to_pylist())):
        mine = Dataset(
            data.place,
            data.index.filter(pc.equal(data.index["split"], split)),
            data.parts,
            data.fields,
        )
        first = made.episodes
        for flight in flights.flights(mine, action, of=data):
            made.add(flight)
            tell_at += 1
            tell(tell_at)
        if made.episodes > first:
            made.splits[split] = f"{first}:{made.episodes}"
    made.close(int(hz))


class _Writing:
    """A dataset in the making."""

    def __init__(self, out: Path, data: Dataset, actions: tuple[str, ...]) -> None:
        others = (int(data.robots.max()) - 1) * len(flights.OTHER)
        self.out = out
        self.splits: dict[str, str] = {}
        self.episodes = self.frames = 0
        self._names: dict[str, list[str]] = {
            "observation.state": list(flights.STATE),
            "action": list(actions),
        }
        if others:
            self._names["observation.environment_state"] = [
                f"other_{i}_{name}"
                for i in range(others // len(flights.OTHER))
                for name in flights.OTHER
            ]
        self._tasks: dict[str, int] = {}
        self._rows: list[dict[str, Any]] = []
        self._files = _Files(out, DATA, self._schema())
        self._sums = {name: _Sums(len(parts)) for name, parts in self._names.items()}

    def _schema(self) -> pa.Schema:
        vectors = [(name, pa.list_(pa.float32(), len(x))) for name, x in self._names.items()]
        return pa.schema(
            [*vectors, ("timestamp", pa.float32()), *((name, pa.int64()) for name in _COUNTED)]
        )

    def add(self, flight: Flight) -> None:
        """Write a flight."""
        steps = len(flight.time_s)
        task = self._tasks.setdefault(flight.task, len(self._tasks))
        values = {
            "observation.state": flight.state,
            "action": flight.action,
            "observation.environment_state": flight.others.reshape(steps, -1),
        }
        columns: dict[str, Any] = {}
        for name, parts in self._names.items():
            rows = np.ascontiguousarray(values[name], np.float32)
            columns[name] = pa.FixedSizeListArray.from_arrays(rows.reshape(-1), len(parts))
            self._sums[name].add(rows)
        columns |= {
            "timestamp": flight.time_s - flight.time_s[0],
            "frame_index": np.arange(steps),
            "episode_index": np.full(steps, self.episodes),
            "index": np.arange(self.frames, self.frames + steps),
            "task_index": np.full(steps, task),
        }
        chunk, file = self._files.write(columns, steps)
        number = self.episodes // PLACES
        self._rows.append(
            {
                "episode_index": self.episodes,
                "tasks": [flight.task],
                "length": steps,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self.frames,
                "dataset_to_index": self.frames + steps,
                "meta/episodes/chunk_index": number // CHUNK,
                "meta/episodes/file_index": number % CHUNK,
                "outcome": flight.outcome,
                "split": flight.split,
            }
        )
        self.episodes += 1
        self.frames += steps

    def close(self, hz: int) -> None:
        """Write what says what all of it is."""
        self._files.close()
        for number, rows in enumerate(_slices(self._rows, PLACES)):
            place = EPISODES.format(chunk_index=number // CHUNK, file_index=number % CHUNK)
            (self.out / place).parent.mkdir(parents=True, exist_ok=True)
            pq.write_table(pa.Table.from_pylist(rows), self.out / place)
        pq.write_table(_tasks(self._tasks), self.out / "meta" / "tasks.parquet")
        folder.write_json(
            self.out / "meta" / "stats.json",
            {name: sums.table() for name, sums in self._sums.items()},
        )
        folder.write_json(self.out / "meta" / "info.json", self._info(hz))

    def _info(self, hz: int) -> dict[str, Any]:
        vectors = {
            name: {"dtype": "float32", "shape": [len(parts)], "names": parts}
            for name, parts in self._names.items()
        }
        counted = {name: {"dtype": "int64", "shape": [1], "names": None} for name in _COUNTED}
        stamp = {"timestamp": {"dtype": "float32", "shape": [1], "names": None}}
        return {
            "codebase_version": VERSION,
            "robot_type": "underwater_vehicle",
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": hz,
            "splits": self.splits,
            "data_path": DATA,
            "video_path": None,
            "features": {**vectors, **stamp, **counted},
        }


class _Files:
    """Data files, one after another."""

    def __init__(self, out: Path, pattern: str, schema: pa.Schema) -> None:
        self._out, self._pattern, self._schema = out, pattern, schema
        self._number, self._frames = -1, FRAMES
        self._writer: Any = None

    def write(self, columns: dict[str, Any], steps: int) -> tuple[int, int]:
        """Write the rows of an episode; says into which chunk and file."""
        if self._frames + steps > FRAMES:
            self.close()
            self._number, self._frames = self._number + 1, 0
            place = self._out / self._pattern.format(
                chunk_index=self._number // CHUNK, file_index=self._number % CHUNK
            )
            place.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(place, self._schema)
        self._frames += steps
        self._writer.write_table(pa.table(columns, schema=self._schema))
        return self._number // CHUNK, self._number % CHUNK

    def close(self) -> None:
        """End the file that is open."""
        if self._writer is not None:
            self._writer.close()


class _Sums:
    """What normalises a feature."""

    def __init__(self, width: int) -> None:
        self._count = 0
        self._first, self._second = np.zeros(width), np.zeros(width)
        self._low, self._high = np.full(width, np.inf), np.full(width, -np.inf)

    def add(self, rows: np.ndarray) -> None:
        """Take rows in."""
        rows = rows.astype(float)
        self._count += len(rows)
        self._first += rows.sum(axis=0)
        self._second += (rows**2).sum(axis=0)
        self._low = np.minimum(self._low, rows.min(axis=0))
        self._high = np.maximum(self._high, rows.max(axis=0))

    def table(self) -> dict[str, list[float]]:
        """By LeRobot's names."""
        mean = self._first / max(self._count, 1)
        spread = np.sqrt(np.maximum(self._second / max(self._count, 1) - mean**2, 0.0))
        return {
            "min": self._low.tolist(),
            "max": self._high.tolist(),
            "mean": mean.tolist(),
            "std": spread.tolist(),
            "count": [self._count],
        }


def _slices(rows: list[dict[str, Any]], step: int) -> Iterator[list[dict[str, Any]]]:
    return (rows[at : at + step] for at in range(0, len(rows), step))


def _tasks(tasks: dict[str, int]) -> pa.Table:
    """As pandas reads it with the tasks as index, which LeRobot counts on."""
    kinds = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    about = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {
                "name": name,
                "field_name": name,
                "pandas_type": kind,
                "numpy_type": of_numpy,
                "metadata": None,
            }
            for name, (kind, of_numpy) in kinds.items()
        ],
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": list(tasks.values()), "task": list(tasks)})
    return table.replace_schema_metadata({"pandas": json.dumps(about)})
