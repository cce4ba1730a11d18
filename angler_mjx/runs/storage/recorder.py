"""Trajectories on disk: one sharded Zarr v3 group, a chunk per world, a shard per tile.

Chunks are compressed by LZ4 after a shuffle of bytes, where they are not stored in steps
(`angler_mjx.runs.storage.quantization.build_quantization`). Samples of ``reef_fleet`` at 10 Hz, two
busy cores, a disk that takes 2 GB/s, median rates in samples before compression and bytes left: LZ4
with byte shuffle 1.4 GB/s, 53 %; without shuffle 1.4 GB/s, 65 %; with bit shuffle 1.1 GB/s, 52 %;
Zstandard 1 with byte shuffle 0.7 GB/s, 50 %; no compression 1.4 GB/s, 100 %. So LZ4 costs nothing
even there, and doubles what a slower disk or more cores can record.
"""

import math
import os
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from functools import cached_property, partial
from pathlib import Path

import numpy as np
import zarr
from numcodecs.blosc import SHUFFLE, Blosc
from zarr.codecs import BloscCodec
from zarr.types import JSON, ArrayV3

from angler_mjx.runs.storage import atomic_files, shards, trajectory_layout
from angler_mjx.runs.storage import environments as store
from angler_mjx.runs.storage.device_to_host import TileArrays
from angler_mjx.runs.storage.quantization import Quantization, build_quantization
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.scenario.store_table import StoreConfig
from angler_mjx.sim.fleet import JointLabel
from angler_mjx.sim.record import JOINT_AXIS
from angler_mjx.world.environment import Environment

SCHEMA_VERSION = 1

ENCODER_THREADS = min(os.cpu_count() or 1, 8)
"""Threads that put worlds together and compress them. LZ4 on a host of 16 (hyper-)threads: 1, 2, 4,
8, 16 threads make 0.9, 1.6, 2.6, 4.2, 3.0 GB/s; more of them only wait for memory to be mapped."""
WRITER_THREADS = 4
"""Arrays of a tile that are written at once."""
BLOCK_BYTES = 2**22
"""Samples that a thread puts together before it compresses them: they stay in its cache."""

_ENCODER = Blosc(cname="lz4", shuffle=SHUFFLE, clevel=1)
"""As the arrays' metadata say; docs/decisions/0004-many-devices.md has what was measured."""


@dataclass(frozen=True, kw_only=True)
class TrajectoryShape:
    """Return the sizes of a run's trajectories."""

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
    armed: bool = False
    """Whether the plans move the joints of arms too."""
    store_config: StoreConfig = field(default_factory=StoreConfig)
    """How finely samples are stored."""
    also: tuple[str, ...] = ()
    """What the run asked for beside what all have."""
    task: dict[str, int] = field(default_factory=dict)
    """Of the dimensions of its task; empty where there is none."""
    joints: Mapping[str, Sequence[JointLabel]] = field(default_factory=dict)
    """Joints of the vehicles that have any, by the vehicle's label, in the order of the arrays."""

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
            JOINT_AXIS: max(map(len, self.joints.values()), default=0),
        }

    def names(self) -> list[str]:
        """Return the names of the run's arrays; see `trajectory_layout`."""
        return trajectory_layout.array_names(
            self.sizes,
            estimated=self.estimated,
            jointed=self.jointed,
            armed=self.armed,
            also=self.also,
        )

    def stepped(self, name: str) -> Quantization | None:
        """Return the quantization of an array; None where it is stored exactly."""
        kind = trajectory_layout.ARRAYS[name]
        if kind.dims[:1] != ("time",) or not np.issubdtype(kind.dtype, np.floating):
            return None
        return build_quantization(self.store_config.step(kind.unit, kind.dims), kind.unit)

    def disk_bytes_per_world(self) -> int:
        """Return the largest size of a world on disk, bytes; a quantized value counts as one."""
        total = 0
        for name in self.names():
            kind, steps = trajectory_layout.ARRAYS[name], self.stepped(name)
            value_bytes = 1 if steps else np.dtype(kind.dtype).itemsize
            total += math.prod(trajectory_layout.array_shape(kind, self.sizes)) * value_bytes
        return total

    def bytes_per_world(self) -> int:
        """Return the uncompressed size of a world's samples and plan, bytes."""
        kinds = [trajectory_layout.ARRAYS[name] for name in self.names()]
        return sum(
            math.prod(trajectory_layout.array_shape(kind, self.sizes))
            * np.dtype(kind.dtype).itemsize
            for kind in kinds
        )


class Recorder:
    """Writes the trajectories of finished tiles into ``trajectories.zarr``."""

    def __init__(self, path: Path, group: zarr.Group, shape: TrajectoryShape, *, tile: int) -> None:
        """Write into ``group`` at ``path``; see ``create`` and ``reopen``."""
        self._path = path
        self._group = group
        self._shape = shape
        self._tile = tile
        # Their threads end with the recorder. Writers wait for the disk, or for encoders.
        self._encoders = ThreadPoolExecutor(ENCODER_THREADS)
        self._writers = ThreadPoolExecutor(WRITER_THREADS)

    @classmethod
    def reopen(cls, path: Path, shape: TrajectoryShape, *, tile: int) -> "Recorder":
        """Go on with the group of an interrupted run.

        Raises:
            ConfigError: it cannot be read.
        """
        with wrap_read_errors(path):
            return cls(path, zarr.open_group(path, mode="r+"), shape, tile=tile)

    def find_missing(self, first_world: int) -> str | None:
        """Name of an array of which a tile is missing or damaged; None if all is there.

        Every file's own account of its length is compared, not every sample.
        """
        for name, path in self._tile_files(first_world).items():
            if not shards.is_sound(path, shard=self._tile if name in self._arrays else None):
                return name
        return None

    def sync(self, first_world: int) -> None:
        """Wait until the files of a tile are on the disk.

        Raises:
            OSError: the disk gave out.
        """
        # Together: one after another, many small files would wait for the disk once each.
        list(self._encoders.map(atomic_files.sync_path, self._tile_files(first_world).values()))

    def _tile_files(self, first_world: int) -> dict[str, Path]:
        """Return the files of a tile by the arrays' names; empty arrays have none."""
        arrays = self._arrays | {
            f"{trajectory_layout.ENVIRONMENT_GROUP}/{name}": array
            for name, array in self._environment.items()
            if array.size
        }
        number = first_world // self._tile
        return {
            name: shards.locate_shard(self._path / name, number, array.ndim)
            for name, array in arrays.items()
        }

    @classmethod
    def create(
        cls,
        path: Path,
        shape: TrajectoryShape,
        environment: Environment,
        *,
        tile: int,
        sample_dt_s: float,
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
        recorder._create_arrays(sample_dt_s)
        store.create_arrays(
            group.create_group(trajectory_layout.ENVIRONMENT_GROUP), environment, shape.worlds, tile
        )
        return recorder

    def _create_arrays(self, sample_dt_s: float) -> None:
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
            trajectory_layout.TIME_ARRAY,
            data=time,
            attributes={"unit": "s"},
            dimension_names=["time"],
        )
        for name in shape.names():
            self._create_array(name, trajectory_layout.ARRAYS[name])

    def _create_array(self, name: str, kind: trajectory_layout.ArrayKind) -> None:
        tail = trajectory_layout.array_shape(kind, self._shape.sizes)
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
            attributes=self._attributes(kind),
            dimension_names=["world", *kind.dims],
        )

    def _attributes(self, kind: trajectory_layout.ArrayKind) -> dict[str, JSON]:
        """Return the attributes of an array; joints have names and units of their own."""
        attributes: dict[str, JSON] = {"unit": kind.unit, "description": kind.text}
        if JOINT_AXIS in kind.dims:
            rate = "/s" if kind.unit.endswith("/s") else ""
            attributes["joints"] = {
                vehicle: [{"name": joint.name, "unit": joint.unit + rate} for joint in joints]
                for vehicle, joints in self._shape.joints.items()
            }
        return attributes

    def _write_environment(self, number: int, count: int, environment: Environment) -> None:
        """Write the chunks of a tile's environments as `environments.write_batch`, without Zarr."""
        for name, leaf in store.named_leaves(environment).items():
            array = self._environment[name]
            values = np.zeros(array.chunks, array.dtype)
            values[:count] = np.asarray(leaf)[:count]
            if values.size:
                path = shards.locate_shard(
                    self._path / trajectory_layout.ENVIRONMENT_GROUP / name, number, array.ndim
                )
                shards.write_file(path, [_ENCODER.encode(values)])

    @cached_property
    def _environment(self) -> dict[str, ArrayV3]:
        """Arrays of the environments by name, opened once."""
        return store.list_arrays(self._group.get_group(trajectory_layout.ENVIRONMENT_GROUP))

    @cached_property
    def _arrays(self) -> dict[str, ArrayV3]:
        """By name, opened once: opening costs as much as writing a small tile."""
        return {name: self._group.get_array(name) for name in self._shape.names()}

    def write(self, first_world: int, arrays: TileArrays, environment: Environment) -> int:
        """Write one tile.

        Args:
            first_world: index of its first world, a multiple of the tile.
            arrays: by name; only worlds of the run lead.
            environment: of the tile's worlds.

        Returns:
            Bytes on disk, the environment's not counted.
        """
        number, count = first_world // self._tile, self._shape.worlds - first_world
        count = min(count, self._tile)
        names = [name for name in arrays if name in self._arrays]

        def write_array(name: str) -> int:
            array = self._arrays[name]
            encode = partial(_encode_chunks, arrays[name], array.dtype, self._shape.stepped(name))
            blocks = self._encoders.map(encode, _split_blocks(array, count))
            path = shards.locate_shard(self._path / name, number, array.ndim)
            return shards.write_shard(path, blocks, shard=self._tile)

        environment_write = self._writers.submit(
            self._write_environment, number, count, environment
        )
        written = [self._writers.submit(write_array, name) for name in names]
        # All of them end before an error is told: nobody writes after this has returned.
        wait(written)
        wait([environment_write])
        environment_write.result()
        return sum(future.result() for future in written)


def _split_blocks(array: ArrayV3, count: int) -> list[slice]:
    """Split worlds [0, kept) into slices of about ``BLOCK_BYTES``."""
    world_bytes = array.nbytes // array.shape[0]
    step = max(1, BLOCK_BYTES // world_bytes)
    return [slice(first, min(first + step, count)) for first in range(0, count, step)]


def _encode_chunks(
    read_rows: Callable[[slice], np.ndarray],
    dtype: np.dtype,
    steps: Quantization | None,
    worlds: slice,
) -> list[bytes]:
    """Encode some worlds, a chunk each."""
    if steps is not None:
        return steps.encode_worlds(read_rows(worlds))
    values = np.ascontiguousarray(read_rows(worlds).astype(dtype, copy=False))
    # Blosc takes the size of an element from the array, and lets other threads run meanwhile.
    return [_ENCODER.encode(value) for value in values]
