"""Trajectories on disk: one sharded Zarr v3 group, a chunk per world, a shard per tile.

Chunks are compressed by LZ4 after a shuffle of bytes. Samples of ``reef_fleet`` at 10 Hz, two busy
cores, a disk that takes 2 GB/s, median rates in samples before compression and bytes left: LZ4 with
byte shuffle 1.4 GB/s, 53 %; without shuffle 1.4 GB/s, 65 %; with bit shuffle 1.1 GB/s, 52 %;
Zstandard 1 with byte shuffle 0.7 GB/s, 50 %; no compression 1.4 GB/s, 100 %. So LZ4 costs nothing
even there, and doubles what a slower disk or more cores can record.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numcodecs.blosc import SHUFFLE, Blosc
from zarr.codecs import BloscCodec

from angler_mjx.storage import environments as store
from angler_mjx.storage import shards
from angler_mjx.storage.harvest import END, ESTIMATE, Arrays
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

_ABOUT: dict[str, tuple[str, str]] = {
    "p_m": ("m", "centre of mass, world frame (x east, y north, z up, 0 at the surface)"),
    "q": ("1", "attitude, quaternion wxyz, body (forward, left, up) to world"),
    "nu": ("m/s, rad/s", "velocity over ground [u v w p q r], body frame"),
    "pwm_us": (
        "us",
        "command of each thruster; 1500 in padding columns, 0 where there was none: of a robot "
        "that diverged, and after all robots of the tile had ended",
    ),
    "target_m": ("m", "where the controller aims, world frame"),
    "current_mps": ("m/s", "water velocity at the robot, world frame"),
    "outcome": (
        "1",
        "0 running, 1 reached, 2 collision_static, 3 collision_dynamic, "
        "4 collision_robot, 5 out_of_bounds, 6 timeout, 7 diverged",
    ),
    "obstacle_p_m": ("m", "centre of each obstacle, world frame"),
    "obstacle_q": ("1", "attitude of each obstacle, quaternion wxyz, body to world"),
}
"""Sampled arrays [world, time, robot or obstacle, ...]: unit and meaning."""

_BODIES = {"obstacle_p_m": 3, "obstacle_q": 4}

_TOLD: dict[str, tuple[int, str, str]] = {
    "p_m": (3, "m", "centre of mass as the controllers were told it, world frame"),
    "q": (4, "1", "attitude as they were told it, quaternion wxyz, body to world"),
    "nu": (6, "m/s, rad/s", "velocity over ground as they were told it, body frame"),
    "position_std_m": (3, "m", "standard deviations of the estimate, world frame; 0 for the truth"),
    "velocity_std_mps": (3, "m/s", "standard deviations of the velocity, world frame"),
    "attitude_std_rad": (3, "rad", "standard deviations of the attitude, about the world's axes"),
}
"""Sampled arrays [world, time, robot, ...] of the group of estimates: width, unit and meaning."""


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

    def bytes_per_world(self) -> int:
        """Uncompressed size of one world's samples and plan."""
        floats = self.robots * (3 + 4 + 6 + 3 + 3 + self.thrusters) + self.obstacles * 7
        if self.estimated:
            floats += self.robots * sum(width for width, _, _ in _TOLD.values())
        return self.samples * (4 * floats + self.robots) + self.robots * self.plan_points * 16


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
        """Go on with the group of an interrupted run."""
        return cls(path, zarr.open_group(path, mode="r+"), shape, tile=tile)

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
        store.describe(group.create_group("environment"), environment, shape.worlds, tile)
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
        self._group.create_array("time_s", data=time, attributes={"unit": "s"})
        per_robot = {"p_m": 3, "q": 4, "nu": 6, "target_m": 3, "current_mps": 3}
        for name, width in per_robot.items():
            self._sampled(name, (shape.robots, width), np.float32)
        self._sampled("pwm_us", (shape.robots, shape.thrusters), np.float32)
        self._sampled("outcome", (shape.robots,), np.uint8)
        for name, width in _BODIES.items():
            self._sampled(name, (shape.obstacles, width), np.float32)
        if shape.estimated:
            for name, (width, unit, meaning) in _TOLD.items():
                tail = (shape.samples, shape.robots, width)
                self._create(f"{ESTIMATE}/{name}", tail, np.float32, unit, meaning)
        self._last()
        points = (shape.robots, shape.plan_points)
        self._create("plan_time_s", points, np.float32, "s", "time of each way-point")
        self._create("plan_m", (*points, 3), np.float32, "m", "way-points, world frame")

    def _last(self) -> None:
        """The state after the last sample: when all robots of the tile had ended, or at the end."""
        shape = self._shape
        step = "control steps until this state, the one after the last sample"
        self._create(f"{END}/step", (), np.int32, "1", step)
        tails = {name: (shape.robots, width) for name, width in (("p_m", 3), ("q", 4), ("nu", 6))}
        tails |= {name: (shape.obstacles, width) for name, width in _BODIES.items()}
        for name, tail in tails.items():
            self._create(f"{END}/{name}", tail, np.float32, *_ABOUT[name])
        self._create(f"{END}/outcome", (shape.robots,), np.uint8, *_ABOUT["outcome"])

    def _sampled(self, name: str, tail: tuple[int, ...], dtype: Any) -> None:
        unit, meaning = _ABOUT[name]
        self._create(name, (self._shape.samples, *tail), dtype, unit, meaning)

    def _create(self, name: str, tail: tuple[int, ...], dtype: Any, unit: str, text: str) -> None:
        if 0 in tail:
            return
        floating = np.issubdtype(dtype, np.floating)
        self._group.create_array(
            name,
            shape=(self._shape.worlds, *tail),
            chunks=(1, *tail),
            shards=(self._tile, *tail),
            dtype=dtype,
            fill_value=np.nan if floating else 0,
            compressors=BloscCodec(cname="lz4", shuffle="shuffle", clevel=1),
            attributes={"unit": unit, "description": text},
        )

    def _write_environment(self, number: int, kept: int, environment: Environment) -> None:
        """Write the chunks of a tile's environments, as `store.write` does, without its calls."""
        for name, leaf in store.leaves(environment).items():
            array = self._environment[name]
            values = np.zeros(array.chunks, array.dtype)
            values[:kept] = np.asarray(leaf)[:kept]
            if values.size:
                place = _place(self._path / "environment" / name, number, array.ndim)
                shards.write_file(place, [_ENCODER.encode(values)])

    @cached_property
    def _environment(self) -> dict[str, Any]:
        """Arrays of the environments by name, opened once."""
        group: Any = self._group["environment"]
        return {name: node for name, node in group.members(max_depth=None)}

    @cached_property
    def _arrays(self) -> dict[str, Any]:
        """By name, opened once: opening costs as much as writing a small tile."""
        arrays: dict[str, Any] = dict(self._group.arrays())
        # A run that was begun by an older version has no end.
        for part in (ESTIMATE, END):
            group: Any = self._group.get(part)
            named = () if group is None else group.arrays()
            arrays.update({f"{part}/{name}": array for name, array in named})
        return arrays

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
            encode = partial(_encoded, arrays[name], array.dtype)
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


def _encoded(take: Callable[[slice], np.ndarray], dtype: np.dtype, worlds: slice) -> list[bytes]:
    """Chunks of some worlds, a chunk each."""
    values = np.ascontiguousarray(take(worlds).astype(dtype, copy=False))
    # Blosc takes the size of an element from the array, and lets other threads run meanwhile.
    return [_ENCODER.encode(value) for value in values]
