"""Trajectories on disk: one sharded Zarr v3 group, a chunk per world, a shard per tile.

Chunks are compressed by LZ4 after a shuffle of bytes, where they are not stored in steps
(`angler_mjx.runs.storage.stepped`). Samples of ``reef_fleet`` at 10 Hz, two busy
cores, a disk that takes 2 GB/s, median rates in samples before compression and bytes left: LZ4 with
byte shuffle 1.4 GB/s, 53 %; without shuffle 1.4 GB/s, 65 %; with bit shuffle 1.1 GB/s, 52 %;
Zstandard 1 with byte shuffle 0.7 GB/s, 50 %; no compression 1.4 GB/s, 100 %. So LZ4 costs nothing
even there, and doubles what a slower disk or more cores can record.
"""

import math
import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numcodecs.blosc import SHUFFLE, Blosc
from zarr.codecs import BloscCodec

from angler_mjx.runs.storage import atomic, layout, shards
from angler_mjx.runs.storage import environments as store
from angler_mjx.runs.storage.damage import reading
from angler_mjx.runs.storage.device_to_host import Arrays
from angler_mjx.runs.storage.stepped import Stepped, stepped
from angler_mjx.scenario.store_table import StoreConfig
from angler_mjx.world.environment import Environment

SCHEMA_VERSION = 1

ENCODERS = min(os.cpu_count() or 1, 8)
"""Threads that put worlds together and compress them. LZ4 on a host of 16 (hyper-)threads: 1, 2, 4,
8, 16 threads make 0.9, 1.6, 2.6, 4.2, 3.0 GB/s; more of them only wait for memory to be mapped."""
WRITERS = 4
"""Arrays of a tile that are written at once."""
BLOCK_BYTES = 2**22
"""Samples that a thread puts together before it compresses them: they stay in its cache."""

_ENCODER = Blosc(cname="lz4", shuffle=SHUFFLE, clevel=1)
"""As the arrays' metadata say; docs/decisions/0004-many-devices.md has what was measured."""


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Sizes of a run's trajectories."""

    worlds: int
    samples: int
    robots: int
    thrusters: int
    obstacles: int
    plan_points: int
    estimated: bool = False
    """Whether any robot's controllers were told something other than the truth."""
    jointed: bool = False
    """Whether the plans are trajectories of joints, with headings and velocities."""
    finely: StoreConfig = field(default_factory=StoreConfig)
    """How finely samples are stored."""
    also: tuple[str, ...] = ()
    """What the run asked for beside what all have."""
    task: dict[str, int] = field(default_factory=dict)
    """Of the dimensions of its task; empty where there is none."""

    @property
    def sizes(self) -> dict[str, int]:
        """By dimension, as `layout` names them."""
        return {
            **self.task,
            "time": self.samples,
            "robot": self.robots,
            "thruster": self.thrusters,
            "obstacle": self.obstacles,
            "way_point": self.plan_points,
        }

    def names(self) -> list[str]:
        """Arrays of the run; see `layout`."""
        return layout.names(
            self.sizes, estimated=self.estimated, jointed=self.jointed, also=self.also
        )

    def stepped(self, name: str) -> Stepped | None:
        """How an array is stored in steps; None where it is stored exactly."""
        kind = layout.ARRAYS[name]
        if kind.dims[:1] != ("time",) or not np.issubdtype(kind.dtype, np.floating):
            return None
        return stepped(self.finely.step(kind.unit, kind.dims), kind.unit)

    def disk_bytes_per_world(self) -> int:
        """What a world takes on the disk at most; in steps a byte a value, twice what is usual."""
        found = 0
        for name in self.names():
            kind, steps = layout.ARRAYS[name], self.stepped(name)
            each = 1 if steps else np.dtype(kind.dtype).itemsize
            found += math.prod(layout.tail(kind, self.sizes)) * each
        return found

    def bytes_per_world(self) -> int:
        """Uncompressed size of one world's samples and plan."""
        kinds = [layout.ARRAYS[name] for name in self.names()]
        return sum(
            math.prod(layout.tail(kind, self.sizes)) * np.dtype(kind.dtype).itemsize
            for kind in kinds
        )


class Recorder:
    """Writes the trajectories of finished tiles into ``trajectories.zarr``."""

    def __init__(self, path: Path, group: zarr.Group, shape: Shape, *, tile: int) -> None:
        """Write into ``group`` at ``path``; see ``create`` and ``reopen``."""
        self._path = path
        self._group = group
        self._shape = shape
        self._tile = tile
        # Their threads end with the recorder. Writers wait for the disk, or for encoders.
        self._encoders = ThreadPoolExecutor(ENCODERS)
        self._writers = ThreadPoolExecutor(WRITERS)

    @classmethod
    def reopen(cls, path: Path, shape: Shape, *, tile: int) -> "Recorder":
        """Go on with the group of an interrupted run.

        Raises:
            ConfigError: it cannot be read.
        """
        with reading(path):
            return cls(path, zarr.open_group(path, mode="r+"), shape, tile=tile)

    def lacks(self, first_world: int) -> str | None:
        """Name of an array of which a tile is missing or damaged; None if all is there.

        Every file's own account of its length is compared, not every sample.
        """
        number = first_world // self._tile
        for name, array in {**self._arrays, **self._around()}.items():
            if not shards.sound(
                _place(self._path / name, number, array.ndim),
                shard=self._tile if name in self._arrays else None,
            ):
                return name
        return None

    def sync(self, first_world: int) -> None:
        """Wait until the files of a tile are on the disk.

        Raises:
            OSError: the disk gave out.
        """
        number = first_world // self._tile
        places = [
            _place(self._path / name, number, array.ndim)
            for name, array in {**self._arrays, **self._around()}.items()
        ]
        # Together: one after another, many small files would wait for the disk once each.
        for done in [self._encoders.submit(atomic.sync, place) for place in places]:
            done.result()

    def _around(self) -> dict[str, Any]:
        """Arrays of the environments that are not empty, by their names in the whole group."""
        return {
            f"{layout.ENVIRONMENT}/{name}": node
            for name, node in self._environment.items()
            if isinstance(node, zarr.Array) and node.size
        }

    @classmethod
    def create(
        cls, path: Path, shape: Shape, environment: Environment, *, tile: int, sample_dt_s: float
    ) -> "Recorder":
        """Make the group and its arrays; nothing is written yet but their descriptions.

        Args:
            path: of the group.
            shape: sizes of the run.
            environment: shapes of a tile's environments.
            tile: worlds of a tile.
            sample_dt_s: time between samples.
        """
        group = zarr.open_group(path, mode="w-")
        recorder = cls(path, group, shape, tile=tile)
        recorder._describe(sample_dt_s)
        store.describe(group.create_group(layout.ENVIRONMENT), environment, shape.worlds, tile)
        return recorder

    def _describe(self, sample_dt_s: float) -> None:
        shape = self._shape
        self._group.attrs.update(
            {
                "schema_version": SCHEMA_VERSION,
                "world_frame": "x east, y north, z up; metres; water surface at z = 0",
                "body_frame": "x forward, y left, z up; origin at the centre of mass",
                "quaternion": "wxyz, body to world",
                "missing": "NaN after all robots of the tile had ended, and in unfinished worlds",
            }
        )
        time = np.arange(shape.samples) * sample_dt_s
        self._group.create_array(
            layout.TIME, data=time, attributes={"unit": "s"}, dimension_names=["time"]
        )
        for name in shape.names():
            self._create(name, layout.ARRAYS[name])

    def _create(self, name: str, kind: layout.FolderKind) -> None:
        tail = layout.tail(kind, self._shape.sizes)
        steps = self._shape.stepped(name)
        self._group.create_array(
            name,
            shape=(self._shape.worlds, *tail),
            chunks=(1, *tail),
            shards=(self._tile, *tail),
            dtype=kind.dtype,
            fill_value=np.nan if np.issubdtype(kind.dtype, np.floating) else 0,
            filters=steps.filters(1 + len(tail)) if steps else "auto",
            compressors=steps.compressor()
            if steps
            else BloscCodec(cname="lz4", shuffle="shuffle", clevel=1),
            attributes={"unit": kind.unit, "description": kind.text},
            dimension_names=["world", *kind.dims],
        )

    def _write_environment(self, number: int, kept: int, environment: Environment) -> None:
        """Write the chunks of a tile's environments, as `store.write` does, without its calls."""
        for name, leaf in store.leaves(environment).items():
            array = self._environment[name]
            values = np.zeros(array.chunks, array.dtype)
            values[:kept] = np.asarray(leaf)[:kept]
            if values.size:
                place = _place(self._path / layout.ENVIRONMENT / name, number, array.ndim)
                shards.write_file(place, [_ENCODER.encode(values)])

    @cached_property
    def _environment(self) -> dict[str, Any]:
        """Arrays of the environments by name, opened once."""
        group: Any = self._group[layout.ENVIRONMENT]
        return {name: node for name, node in group.members(max_depth=None)}

    @cached_property
    def _arrays(self) -> dict[str, Any]:
        """By name, opened once: opening costs as much as writing a small tile."""
        return {name: self._group[name] for name in self._shape.names()}

    def write(self, first_world: int, arrays: Arrays, environment: Environment) -> int:
        """Write one tile.

        Args:
            first_world: index of its first world, a multiple of the tile.
            arrays: by name; only worlds of the run lead.
            environment: of the tile's worlds.

        Returns:
            Bytes on disk, the environment's not counted.
        """
        number, kept = first_world // self._tile, self._shape.worlds - first_world
        kept = min(kept, self._tile)
        names = [name for name in arrays if name in self._arrays]

        def one(name: str) -> int:
            array = self._arrays[name]
            encode = partial(_encoded, arrays[name], array.dtype, self._shape.stepped(name))
            blocks = self._encoders.map(encode, _blocks(array, kept))
            place = _place(self._path / name, number, array.ndim)
            return shards.write(place, blocks, shard=self._tile)

        around = self._writers.submit(self._write_environment, number, kept, environment)
        written = [self._writers.submit(one, name) for name in names]
        # All of them end before an error is told: nobody writes after this has returned.
        wait(written)
        wait([around])
        around.result()
        return sum(future.result() for future in written)


def _place(array: Path, shard: int, ndim: int) -> Path:
    """File of a shard; only the worlds are divided."""
    return array / "c" / "/".join([str(shard), *"0" * (ndim - 1)])


def _blocks(array: Any, kept: int) -> list[slice]:
    """Worlds [0, kept) in slices of about ``BLOCK_BYTES``."""
    world_bytes = array.nbytes // array.shape[0]
    step = max(1, BLOCK_BYTES // world_bytes)
    return [slice(first, min(first + step, kept)) for first in range(0, kept, step)]


def _encoded(
    take: Callable[[slice], np.ndarray], dtype: np.dtype, steps: Stepped | None, worlds: slice
) -> list[bytes]:
    """Chunks of some worlds, a chunk each."""
    if steps is not None:
        return steps.encoded(take(worlds))
    values = np.ascontiguousarray(take(worlds).astype(dtype, copy=False))
    # Blosc takes the size of an element from the array, and lets other threads run meanwhile.
    return [_ENCODER.encode(value) for value in values]
