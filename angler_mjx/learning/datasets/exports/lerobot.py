"""LeRobot dataset, version 3.0: one robot's flight per episode, without images.

Episodes are ordered by split, so that ``splits`` of ``info.json`` are ranges. Reading needs
LeRobot; writing needs Parquet and JSON alone.
"""

import json
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import pyarrow as pa
import pyarrow.compute as pc
import pyarrow.parquet as pq

from angler_mjx.errors import ConfigError
from angler_mjx.learning.datasets.dataset import Dataset
from angler_mjx.learning.datasets.exports import flights
from angler_mjx.learning.datasets.exports.flights import ExportedFlight
from angler_mjx.runs.storage.atomic_files import write_json

FORMAT_VERSION = "v3.0"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES_PATH = "meta/episodes/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
CHUNK_SIZE = 1000
"""Maximum number of files of a folder."""
MAX_FRAMES = 500_000
"""Maximum number of frames of a data file."""
EPISODES_PER_FILE = 10_000
"""Episodes of a file of episodes, some 50 MB of statistics at most."""
ROW_GROUP_SIZE = 1000
"""Episodes of a row group, which are kept in memory until they are written."""

QUANTILES = {"q01": 0.01, "q10": 0.10, "q50": 0.50, "q90": 0.90, "q99": 0.99}
"""Quantiles by the names of LeRobot's statistics."""
STATISTIC_NAMES = ("min", "max", "mean", "std", "count", *QUANTILES)
"""Statistics of a feature, in LeRobot's order."""

type Statistics = dict[str, np.ndarray]
"""Values [width] of a feature by the names of `STATISTIC_NAMES`; ``count`` is [1]."""

_INTEGER_COLUMNS = ("frame_index", "episode_index", "index", "task_index")


def write_dataset(data: Dataset, out: Path, action: str, progress: Callable[[int], None]) -> None:
    """Write a LeRobot dataset; arguments and errors as of `parquet.write_dataset`.

    Raises:
        ConfigError: the recording rate is not a whole number, as LeRobot requires.
    """
    hz = data.run(int(data.index["part"][0].as_py())).scenario.time.record_hz
    if hz != int(hz):
        raise ConfigError(f"record_hz = {hz:g}: LeRobot takes whole numbers of frames a second")
    names = flights.action_names(data, action)
    writer = _LeRobotWriter(out, data, names)
    n_written = 0
    for split in sorted(set(data.index["split"].to_pylist())):
        split_data = Dataset(
            data.root,
            data.index.filter(pc.equal(data.index["split"], split)),
            data.parts,
            data.fields,
        )
        first = writer.episodes
        for flight in flights.iterate_flights(split_data, action, of=data):
            writer.add(flight)
            n_written += 1
            progress(n_written)
        if writer.episodes > first:
            writer.splits[split] = f"{first}:{writer.episodes}"
    writer.close(int(hz))


class _LeRobotWriter:
    """Writer of a dataset."""

    def __init__(self, out: Path, data: Dataset, actions: tuple[str, ...]) -> None:
        others = list(flights.other_names(data))
        self.out = out
        self.splits: dict[str, str] = {}
        self.episodes = self.frames = 0
        self._names: dict[str, list[str]] = {
            "observation.state": list(flights.STATE_COLUMNS),
            "action": list(actions),
        }
        if others:
            self._names["observation.environment_state"] = others
        self._tasks: dict[str, int] = {}
        self._files = _DataFileWriter(out, DATA_PATH, self._schema())
        self._episodes = _EpisodeFileWriter(out)
        self._statistics: dict[str, Statistics] = {}

    def _schema(self) -> pa.Schema:
        vectors = [(name, pa.list_(pa.float32(), len(x))) for name, x in self._names.items()]
        return pa.schema(
            [
                *vectors,
                ("timestamp", pa.float32()),
                *((name, pa.int64()) for name in _INTEGER_COLUMNS),
            ]
        )

    def add(self, flight: ExportedFlight) -> None:
        """Write a flight."""
        steps = len(flight.time_s)
        task = self._tasks.setdefault(flight.task, len(self._tasks))
        values = {
            "observation.state": flight.state,
            "action": flight.action,
            "observation.environment_state": flight.others.reshape(steps, -1),
        }
        counted = {
            "timestamp": flight.time_s - flight.time_s[0],
            "frame_index": np.arange(steps),
            "episode_index": np.full(steps, self.episodes),
            "index": np.arange(self.frames, self.frames + steps),
            "task_index": np.full(steps, task),
        }
        columns: dict[str, pa.Array | np.ndarray] = {}
        statistics: dict[str, Statistics] = {}
        for name, parts in self._names.items():
            rows = np.ascontiguousarray(values[name], np.float32)
            columns[name] = pa.FixedSizeListArray.from_arrays(rows.reshape(-1), len(parts))
            statistics[name] = compute_statistics(rows)
        for name, numbers in counted.items():
            columns[name] = numbers
            statistics[name] = compute_statistics(numbers[:, None])
        self._aggregate_statistics(statistics)
        chunk, file = self._files.write(columns, steps)
        number = self.episodes // EPISODES_PER_FILE
        self._episodes.add(
            {
                "episode_index": self.episodes,
                "tasks": [flight.task],
                "length": steps,
                "data/chunk_index": chunk,
                "data/file_index": file,
                "dataset_from_index": self.frames,
                "dataset_to_index": self.frames + steps,
                **build_statistics_columns(statistics),
                "meta/episodes/chunk_index": number // CHUNK_SIZE,
                "meta/episodes/file_index": number % CHUNK_SIZE,
                "outcome": flight.outcome,
                "split": flight.split,
            }
        )
        self.episodes += 1
        self.frames += steps

    def _aggregate_statistics(self, episode: dict[str, Statistics]) -> None:
        """Merge an episode's statistics into those of all episodes."""
        for name, statistics in episode.items():
            before = [self._statistics[name]] if name in self._statistics else []
            self._statistics[name] = aggregate_statistics([*before, statistics])

    def close(self, hz: int) -> None:
        """Write the metadata of the whole dataset."""
        self._files.close()
        self._episodes.close()
        pq.write_table(_build_task_table(self._tasks), self.out / "meta" / "tasks.parquet")
        write_json(
            self.out / "meta" / "stats.json",
            {
                feature: {name: values.tolist() for name, values in statistics.items()}
                for feature, statistics in self._statistics.items()
            },
        )
        write_json(self.out / "meta" / "info.json", self._build_info(hz))

    def _build_info(self, hz: int) -> dict[str, object]:
        vectors = {
            name: {"dtype": "float32", "shape": [len(parts)], "names": parts}
            for name, parts in self._names.items()
        }
        counted = {
            name: {"dtype": "int64", "shape": [1], "names": None} for name in _INTEGER_COLUMNS
        }
        stamp = {"timestamp": {"dtype": "float32", "shape": [1], "names": None}}
        return {
            "codebase_version": FORMAT_VERSION,
            "robot_type": "underwater_vehicle",
            "total_episodes": self.episodes,
            "total_frames": self.frames,
            "total_tasks": len(self._tasks),
            "chunks_size": CHUNK_SIZE,
            "data_files_size_in_mb": 100,
            "video_files_size_in_mb": 200,
            "fps": hz,
            "splits": self.splits,
            "data_path": DATA_PATH,
            "video_path": None,
            "features": {**vectors, **stamp, **counted},
        }


class _DataFileWriter:
    """Data files, one after another."""

    def __init__(self, out: Path, pattern: str, schema: pa.Schema) -> None:
        self._out, self._pattern, self._schema = out, pattern, schema
        self._number, self._frames = -1, MAX_FRAMES
        self._writer: pq.ParquetWriter | None = None

    def write(self, columns: Mapping[str, pa.Array | np.ndarray], steps: int) -> tuple[int, int]:
        """Write the rows of an episode; return its chunk and file."""
        if self._writer is None or self._frames + steps > MAX_FRAMES:
            self.close()
            self._number, self._frames = self._number + 1, 0
            path = self._out / self._pattern.format(
                chunk_index=self._number // CHUNK_SIZE, file_index=self._number % CHUNK_SIZE
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, self._schema)
        self._frames += steps
        self._writer.write_table(pa.table(columns, schema=self._schema))
        return self._number // CHUNK_SIZE, self._number % CHUNK_SIZE

    def close(self) -> None:
        """Close the open file."""
        if self._writer is not None:
            self._writer.close()


class _EpisodeFileWriter:
    """Files of episodes, one after another, a row group at a time."""

    def __init__(self, out: Path) -> None:
        self._out = out
        self._rows: list[Mapping[str, object]] = []
        self._count = 0
        self._writer: pq.ParquetWriter | None = None

    def add(self, row: Mapping[str, object]) -> None:
        """Add the row of an episode."""
        if self._count % EPISODES_PER_FILE == 0:
            self.close()
        self._rows.append(row)
        self._count += 1
        if len(self._rows) == ROW_GROUP_SIZE:
            self._flush()

    def close(self) -> None:
        """Write the remaining rows and close the open file."""
        self._flush()
        if self._writer is not None:
            self._writer.close()
            self._writer = None

    def _flush(self) -> None:
        if not self._rows:
            return
        table = pa.Table.from_pylist(self._rows)
        if self._writer is None:
            number = (self._count - 1) // EPISODES_PER_FILE
            path = self._out / EPISODES_PATH.format(
                chunk_index=number // CHUNK_SIZE, file_index=number % CHUNK_SIZE
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            self._writer = pq.ParquetWriter(path, table.schema)
        self._writer.write_table(table)
        self._rows = []


def _build_task_table(tasks: dict[str, int]) -> pa.Table:
    """Build the table of tasks as pandas reads it with the tasks as index, as LeRobot requires."""
    dtypes = {"task_index": ("int64", "int64"), "task": ("unicode", "object")}
    pandas_metadata = {
        "index_columns": ["task"],
        "column_indexes": [],
        "columns": [
            {
                "name": name,
                "field_name": name,
                "pandas_type": pandas_type,
                "numpy_type": numpy_type,
                "metadata": None,
            }
            for name, (pandas_type, numpy_type) in dtypes.items()
        ],
        "pandas_version": "2.0.0",
    }
    table = pa.table({"task_index": list(tasks.values()), "task": list(tasks)})
    return table.replace_schema_metadata({"pandas": json.dumps(pandas_metadata)})


def compute_statistics(rows: np.ndarray) -> Statistics:
    """Return the statistics of a feature over one episode.

    LeRobot's editing tools (delete, split, merge) aggregate the statistics of the episodes that are
    left: a dataset without them leaves its policies nothing to normalise by.

    A quantile is the smallest value that the fraction of the samples does not exceed: LeRobot's own
    are that value to a bin of its histogram, the range over 5,000.

    Args:
        rows: [samples, width], at least one sample.
    """
    rows = rows.astype(float)
    quantiles = np.quantile(rows, list(QUANTILES.values()), axis=0, method="inverted_cdf")
    return {
        "min": rows.min(axis=0),
        "max": rows.max(axis=0),
        "mean": rows.mean(axis=0),
        "std": rows.std(axis=0),
        "count": np.array([len(rows)]),
        **dict(zip(QUANTILES, quantiles, strict=True)),
    }


def aggregate_statistics(episodes: Iterable[Statistics]) -> Statistics:
    """Return the statistics of a feature over several episodes, as LeRobot aggregates them.

    Mean and standard deviation are those of all samples. Quantiles are the means of the episodes'
    quantiles, weighted by samples.
    """
    stacked = [np.stack(values) for values in zip(*map(_ordered_values, episodes), strict=True)]
    by_name = dict(zip(STATISTIC_NAMES, stacked, strict=True))
    count = by_name["count"]
    total = count.sum(axis=0)
    mean = (by_name["mean"] * count).sum(axis=0) / total
    variance = ((by_name["std"] ** 2 + (by_name["mean"] - mean) ** 2) * count).sum(axis=0) / total
    return {
        "min": by_name["min"].min(axis=0),
        "max": by_name["max"].max(axis=0),
        "mean": mean,
        "std": np.sqrt(variance),
        "count": total,
        **{name: (by_name[name] * count).sum(axis=0) / total for name in QUANTILES},
    }


def _ordered_values(statistics: Statistics) -> list[np.ndarray]:
    return [statistics[name] for name in STATISTIC_NAMES]


def build_statistics_columns(features: Mapping[str, Statistics]) -> dict[str, list[float]]:
    """Return the columns of an episode's row: ``stats/FEATURE/NAME``, lists of numbers."""
    return {
        f"stats/{feature}/{name}": values.tolist()
        for feature, statistics in features.items()
        for name, values in statistics.items()
    }
