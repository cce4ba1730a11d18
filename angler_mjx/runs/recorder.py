"""Trajectories on disk: one sharded Zarr v3 group, a chunk per world, a shard per tile."""

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import zarr
from numcodecs.blosc import SHUFFLE, Blosc
from zarr.codecs import BloscCodec

from angler_mjx.runs import shards
from angler_mjx.runs.harvest import Arrays
from angler_mjx.world import store
from angler_mjx.world.environment import Environment

SCHEMA_VERSION = 1

THREADS = min(8, os.cpu_count() or 1)
"""Arrays of a tile that are put together, compressed and written at once."""

_ENCODER = Blosc(cname="lz4", shuffle=SHUFFLE, clevel=1)
"""As the arrays' metadata say; docs/decisions/0004-many-devices.md has what was measured."""

_ABOUT: dict[str, tuple[str, str]] = {
    "p_m": ("m", "centre of mass, world frame (x east, y north, z up, 0 at the surface)"),
    "q": ("1", "attitude, quaternion wxyz, body (forward, left, up) to world"),
    "nu": ("m/s, rad/s", "velocity over ground [u v w p q r], body frame"),
    "pwm_us": (
        "us",
        "command of each thruster; 1500 in padding columns, 0 where a diverged robot had none",
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


@dataclass(frozen=True, kw_only=True)
class Shape:
    """Sizes of a run's trajectories."""

    worlds: int
    samples: int
    robots: int
    thrusters: int
    obstacles: int
    plan_points: int

    def bytes_per_world(self) -> int:
        """Uncompressed size of one world's samples and plan."""
        floats = self.robots * (3 + 4 + 6 + 3 + 3) + self.obstacles * 7
        small = self.robots * (2 * self.thrusters + 1)
        return self.samples * (4 * floats + small) + self.robots * self.plan_points * 16


class Recorder:
    """Writes the trajectories of finished tiles into ``trajectories.zarr``."""

    def __init__(self, path: Path, group: zarr.Group, shape: Shape, *, tile: int) -> None:
        """Write into ``group`` at ``path``; see ``create`` and ``reopen``."""
        self._path = path
        self._group = group
        self._shape = shape
        self._tile = tile

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
        self._sampled("pwm_us", (shape.robots, shape.thrusters), np.uint16)
        self._sampled("outcome", (shape.robots,), np.uint8)
        self._sampled("obstacle_p_m", (shape.obstacles, 3), np.float32)
        self._sampled("obstacle_q", (shape.obstacles, 4), np.float32)
        points = (shape.robots, shape.plan_points)
        self._create("plan_time_s", points, np.float32, "s", "time of each way-point")
        self._create("plan_m", (*points, 3), np.float32, "m", "way-points, world frame")

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

    def write(self, first_world: int, arrays: Arrays, environment: Environment) -> int:
        """Write one tile.

        Args:
            first_world: index of its first world, a multiple of the tile.
            arrays: by name; only worlds of the run lead.
            environment: of the tile's worlds.

        Returns:
            Bytes on disk, the environment's not counted.
        """
        group: Any = self._group
        number = first_world // self._tile

        def one(name: str) -> int:
            values = arrays[name]()
            if 0 in values.shape[1:]:
                return 0
            values = values.astype(group[name].dtype, copy=False)
            place = self._path / name / "c" / "/".join([str(number), *"0" * (values.ndim - 1)])
            return shards.write(place, values, shard=self._tile, codec=_ENCODER)

        with ThreadPoolExecutor(THREADS) as pool:
            around = pool.submit(store.write, group["environment"], first_world, environment)
            written = sum(pool.map(one, arrays))
            around.result()
        return written
