"""Arrays of trajectories, read a world at a time from shards of our own format.

A chunk of these arrays is a world, and Zarr's own reader takes 2 ms of Python for each. Codecs
other than those of `runs.storage.recorder` are left to Zarr.
"""

import json
import mmap
import threading
from collections import OrderedDict
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import zarr
from numcodecs import blosc

from angler_mjx.runs.storage import shards
from angler_mjx.runs.storage.read_errors import wrap_read_errors

MAX_SHARDS = 64
"""Maximum number of open files of an array."""
MAX_CHUNKS = 64
"""Worlds of an array that each thread keeps decoded, some 30 MB of all arrays of four robots:
windows of one episode are read in sequence, and so are those of a group (`loaders.shuffling`)."""

type _Shard = tuple[memoryview, list[list[int]]]
"""Bytes of a file, and offset and length of each of its worlds."""


@dataclass(frozen=True, kw_only=True)
class _ArrayFormat:
    """Format of an array, from ``zarr.json``."""

    shape: tuple[int, ...]
    dtype: np.dtype
    fill: float
    shard: int
    """Number of worlds in a file."""
    stored: np.dtype
    """Type of the compressed values."""
    per_unit: np.float32 | None
    """Number of steps in one unit; None where values are stored as they are."""
    missing: int = 0
    """Step that stands for NaN."""
    endless: int | None = None
    """Step that stands for inf; None where there is none."""


class StoredArray:
    """Array [world, time, ...], or [world, ...], of a run; threads may share it."""

    def __init__(self, path: Path) -> None:
        """Read the format of an array; its values are read later.

        Args:
            path: folder of the array.

        Raises:
            ConfigError: the folder is no array, or is damaged.
        """
        self.path = path
        with wrap_read_errors(path / "zarr.json"):
            text = (path / "zarr.json").read_text(encoding="utf-8")
            self._source = _parse_format(text) or zarr.open_array(path, mode="r")
        self.shape: tuple[int, ...] = tuple(self._source.shape)
        self.dtype: np.dtype = np.dtype(self._source.dtype)
        self._init_cache()

    def _init_cache(self) -> None:
        self._lock = threading.Lock()
        self._files: OrderedDict[int, _Shard] = OrderedDict()
        self._thread_cache = threading.local()

    def __getstate__(self) -> dict[str, object]:
        """Return the state for another process, where files are opened anew."""
        left_out = ("_lock", "_files", "_thread_cache")
        return {key: value for key, value in self.__dict__.items() if key not in left_out}

    def __setstate__(self, state: dict[str, object]) -> None:
        """Restore the state in another process."""
        self.__dict__.update(state)
        self._init_cache()

    def read(self, world: int, times: slice | None = None) -> np.ndarray:
        """Read the values of a world.

        Args:
            world: index of the world.
            times: range of the first axis after the worlds; all if None.

        Returns:
            [time, ...], equal to Zarr's; read-only.

        Raises:
            ConfigError: the file is damaged.
            IndexError: the world does not exist.
        """
        if not 0 <= world < self.shape[0]:
            raise IndexError(f"{self.path}: world {world} of {self.shape[0]}")
        form = self._source
        if not isinstance(form, _ArrayFormat):
            with wrap_read_errors(self.path):
                whole: np.ndarray = np.asarray(form[world])
                return whole if times is None else whole[times]
        chunk = self._read_cached(form, world)
        if form.per_unit is None:
            return chunk if times is None else chunk[times]
        part = chunk if times is None else chunk[..., times]
        return _decode_steps(form, form.per_unit, np.moveaxis(part, -1, 0))

    def read_worlds(self, first: int, last: int) -> np.ndarray:
        """Read the values of neighbouring worlds, without the cache of `read`.

        Args:
            first: index of the first world.
            last: index behind the last world.

        Returns:
            [world, time, ...], equal to Zarr's.

        Raises:
            ConfigError: the file is damaged.
            IndexError: a world does not exist.
        """
        if not 0 <= first < last <= self.shape[0]:
            raise IndexError(f"{self.path}: worlds {first} to {last - 1} of {self.shape[0]}")
        form = self._source
        if not isinstance(form, _ArrayFormat):
            with wrap_read_errors(self.path):
                return np.asarray(form[first:last])
        steps = np.empty((last - first, *_chunk_shape(form)), form.stored)
        for world in range(first, last):
            steps[world - first] = self._read_chunk(form, world)
        if form.per_unit is None:
            return steps
        return _decode_steps(form, form.per_unit, np.moveaxis(steps, -1, 1))

    def _read_cached(self, form: _ArrayFormat, world: int) -> np.ndarray:
        """Return the stored chunk of a world, from the thread's cache if it is there."""
        chunks: OrderedDict[int, np.ndarray] | None = getattr(self._thread_cache, "chunks", None)
        if chunks is None:
            chunks = self._thread_cache.chunks = OrderedDict()
        if world in chunks:
            chunks.move_to_end(world)
            return chunks[world]
        values = chunks[world] = self._read_chunk(form, world)
        if len(chunks) > MAX_CHUNKS:
            chunks.popitem(last=False)
        return values

    def _read_chunk(self, form: _ArrayFormat, world: int) -> np.ndarray:
        """Return the stored chunk of a world: steps with time last, or values."""
        data = self._read_bytes(form, world)
        if data is None:
            fill = form.fill if form.per_unit is None else form.missing
            return np.full(_chunk_shape(form), fill, form.stored)
        with wrap_read_errors(self.path):
            return np.frombuffer(blosc.decompress(data), form.stored).reshape(_chunk_shape(form))

    def _read_bytes(self, form: _ArrayFormat, world: int) -> memoryview | None:
        """Return a compressed chunk; None where there is none."""
        number, at = divmod(world, form.shard)
        with self._lock:
            shard = self._files.get(number)
            if shard is None:
                shard = self._open_shard(form, number)
                self._files[number] = shard
                if len(self._files) > MAX_SHARDS:
                    self._files.popitem(last=False)
            else:
                self._files.move_to_end(number)
        file, index = shard
        offset, length = index[at]
        return None if offset == shards.ABSENT else file[offset : offset + length]

    def _open_shard(self, form: _ArrayFormat, number: int) -> _Shard:
        """Return the bytes of a shard, read from disk where they are decompressed, and its index.

        Raises:
            ConfigError: the shard is missing, truncated, or its index is damaged.
        """
        path = shards.locate_shard(self.path, number, len(form.shape))
        with wrap_read_errors(path):
            with path.open("rb") as opened:
                file = mmap.mmap(opened.fileno(), 0, access=mmap.ACCESS_READ)
            tail = file[-shards.index_bytes(form.shard) :]
            index = shards.read_index(tail, shard=form.shard, file_bytes=len(file))
        return memoryview(file), index.tolist()


def _chunk_shape(form: _ArrayFormat) -> tuple[int, ...]:
    """Return the shape of a stored chunk: steps have time last, values have it first."""
    tail = form.shape[1:]
    return tail if form.per_unit is None else (*tail[1:], tail[0])


def _decode_steps(form: _ArrayFormat, per_unit: np.float32, steps: np.ndarray) -> np.ndarray:
    """Return the values float32 [...] of steps [...]."""
    values: np.ndarray = np.divide(steps, per_unit, dtype=np.float32)
    is_missing = steps == form.missing
    if is_missing.any():
        values[is_missing] = np.nan
    if form.endless is not None and (is_infinite := steps == form.endless).any():
        values[is_infinite] = np.inf
    return values


def _parse_format(text: str) -> _ArrayFormat | None:
    """Return the format of an array of our own recorder by its ``zarr.json``; None for any other.

    Raises:
        ValueError: the text is not JSON.
    """
    metadata = json.loads(text)
    try:
        (outer,) = metadata["codecs"]
        inner = outer["configuration"]["codecs"]
        names = [codec["name"] for codec in inner]
        shape = tuple(metadata["shape"])
        chunk = tuple(outer["configuration"]["chunk_shape"])
        shard_shape = tuple(metadata["chunk_grid"]["configuration"]["chunk_shape"])
        is_native = (
            outer["name"] == "sharding_indexed"
            and outer["configuration"].get("index_location", "end") == "end"
            and chunk == (1, *shape[1:])
            and shard_shape[1:] == shape[1:]
            and metadata["chunk_key_encoding"]["configuration"]["separator"] == "/"
            and names[-2:] == ["bytes", "blosc"]
            and inner[-2].get("configuration", {}).get("endian", "little") == "little"
        )
        dtype = np.dtype(metadata["data_type"])
        plain = _ArrayFormat(
            shape=shape,
            dtype=dtype,
            fill=float(metadata["fill_value"]),
            shard=int(shard_shape[0]),
            stored=dtype,
            per_unit=None,
        )
        if is_native and len(names) == 2:
            return plain
        if not is_native or names[:3] != ["transpose", "scale_offset", "cast_value"]:
            return None
        order, scale, cast = (codec.get("configuration", {}) for codec in inner[:3])
        stands_for = {value: steps for steps, value in cast["scalar_map"]["decode"]}
        is_supported = (
            tuple(order["order"]) == (0, *range(2, len(shape)), 1)
            and scale.get("offset", 0) == 0
            and dtype == np.float32
            and "NaN" in stands_for
            and stands_for.keys() <= {"NaN", "Infinity"}
        )
    except (KeyError, TypeError, ValueError):
        return None
    if not is_supported:
        return None
    return replace(
        plain,
        stored=np.dtype(cast["data_type"]),
        per_unit=np.float32(scale.get("scale", 1)),
        missing=int(stands_for["NaN"]),
        endless=stands_for.get("Infinity"),
    )
