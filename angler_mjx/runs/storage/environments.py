"""Environments on disk: arrays of a Zarr v3 group, worlds leading, one chunk per tile.

The names of the arrays are those of the fields of `Environment`, with "/" between levels
(``grid/occupied``, ``current/0/core_m``). What is not an array (which kinds of current there are)
stands in the group's attributes, so that a group can be read without the config that made it.
"""

from collections.abc import Callable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import jax
import numpy as np
import zarr
from jax.tree_util import keystr
from zarr.codecs import BloscCodec
from zarr.types import ArrayV3

from angler_mjx.errors import ConfigError
from angler_mjx.planning.problem import Problem
from angler_mjx.runs.storage import array_metadata, input_copies, results_folder
from angler_mjx.runs.storage.read_errors import wrap_read_errors
from angler_mjx.world import currents, ocean
from angler_mjx.world.config import WorldConfig, resolve_world
from angler_mjx.world.environment import Environment
from angler_mjx.world.generate import generate_batch, require_valid
from angler_mjx.world.obstacles import Obstacles
from angler_mjx.world.rock.grid import Grid

SCHEMA_VERSION = 1

_CURRENTS: dict[str, type] = {
    kind.__name__: kind
    for kind in (
        currents.Uniform,
        currents.GaussMarkov,
        currents.Vortices,
        currents.Rankine,
        currents.DoubleGyre,
        currents.DepthProfile,
        currents.Tide,
        currents.Gridded,
    )
}
"""Kinds of current by the names in a group."""

_DIMS = {
    "start_m": ("robot", "xyz"),
    "goal_m": ("robot", "xyz"),
    "start_yaw_rad": ("robot",),
    "path_ratio": ("robot",),
    "line_free": ("robot",),
    "grid/occupied": ("x", "y", "z"),
    "grid/origin_m": ("xyz",),
    "obstacles/size_m": ("obstacle", "size"),
    "obstacles/path": ("obstacle", "column"),
    "obstacles/p0": ("obstacle", "xyz"),
    "obstacles/q0": ("obstacle", "wxyz"),
    "obstacles/nu0": ("obstacle", "uvwpqr"),
    "obstacles/inertia_kgm2": ("obstacle", "xyz"),
    "obstacles/M_A": ("obstacle", "uvwpqr"),
    "obstacles/D_l": ("obstacle", "uvwpqr"),
    "obstacles/D_q": ("obstacle", "uvwpqr"),
}
"""Dimensions after ``world``; of what is not here they are called after the array."""

_SHARED = {"world", "robot", "obstacle", "xyz", "wxyz", "uvwpqr"}
"""Dimensions of one size in a whole group."""

MAX_BYTES = 2**30
"""Of one world's array: what claims more is damaged."""


def create_arrays(group: zarr.Group, environment: Environment, count: int, tile: int) -> None:
    """Make the arrays of a group; nothing is written into them yet.

    Args:
        group: empty.
        environment: a batch as it will be written, or its shapes (`jax.eval_shape`).
        count: number of worlds of the whole group.
        tile: worlds of one chunk.
    """
    group.attrs.update(
        {
            "schema": "angler_mjx environment",
            "schema_version": SCHEMA_VERSION,
            "world_frame": "x east, y north, z up; metres; water surface at z = 0",
            "cells": "cell (i, j, k) spans origin_m + cell_m * [i, i+1] x [j, j+1] x [k, k+1]",
            "quaternion": "wxyz, body to world",
            "current": [type(component).__name__ for component in environment.current],
            "obstacle_kinds": list(environment.obstacles.kinds),
            "obstacle_motions": list(environment.obstacles.motions),
        }
    )
    files = [_describe_field(component) for component in environment.current]
    if any(files):
        group.attrs["current_file"] = files
    current = tuple(type(component).__name__ for component in environment.current)
    for name, leaf in named_leaves(environment).items():
        tail, metadata = leaf.shape[1:], array_metadata.describe_array(name, current)
        group.create_array(
            name,
            shape=(count, *tail),
            chunks=(min(tile, count), *tail),
            dtype=np.dtype(leaf.dtype),
            compressors=BloscCodec(cname="lz4", shuffle="shuffle", clevel=1),
            attributes=metadata.attributes(),
            dimension_names=["world", *metadata.axes],
        )


def _describe_field(component: currents.Component) -> dict[str, str | None] | None:
    """Return the place of a current's field, which worlds do not hold; None without one."""
    if not isinstance(component, currents.Gridded):
        return None
    field = component.field
    u, v, w = field.names
    return {"file": field.source, "digest": field.digest, "u": u, "v": v, "w": w}


def write_batch(group: zarr.Group, first: int, environment: Environment) -> None:
    """Write a batch; worlds past the end of the group are dropped.

    Args:
        group: described before.
        first: index of the batch's first world in the group.
        environment: batch of worlds.
    """
    for name, leaf in named_leaves(environment).items():
        array = group.get_array(name)
        last = min(first + leaf.shape[0], array.shape[0])
        array[first:last] = np.asarray(leaf)[: last - first]


def read_environments(group: zarr.Group, index: int | slice) -> Environment:
    """Read one world of a group, or a batch of them; leaves are host arrays.

    Args:
        group: written before.
        index: of one world, or a slice of worlds.

    Raises:
        ConfigError: the group is damaged.
    """
    with wrap_read_errors(_group_path(group)):
        return _read_group(group, index)


def list_arrays(group: zarr.Group) -> dict[str, ArrayV3]:
    """Return the arrays of a group and of the groups in it, by name."""
    nodes = group.members(max_depth=None)
    return {name: node for name, node in nodes if isinstance(node, zarr.Array)}


def check_arrays(arrays: Mapping[str, ArrayV3], path: Path) -> None:
    """Refuse a group whose arrays do not fit together, before anything of them is read.

    Args:
        arrays: of the group, by their names.
        path: it lies, for messages.

    Raises:
        ConfigError: naming the array.
    """
    sizes = {"xyz": 3, "wxyz": 4, "uvwpqr": 6}
    for name, array in arrays.items():
        dims = ("world", *_array_dims(name, array.ndim - 1))
        # Other dimensions are an array's own.
        keys = [dim if dim in _SHARED else f"{name} {dim}" for dim in dims]
        fits = len(dims) == array.ndim and all(
            sizes.setdefault(key, size) == size for key, size in zip(keys, array.shape, strict=True)
        )
        if not fits or array.nbytes > MAX_BYTES * max(1, array.shape[0]):
            raise ConfigError(
                f"{path}/{name}: has the shape {array.shape}, which does not fit the "
                "others; copy its zarr.json again, or make the file anew"
            )


def _group_path(group: zarr.Group) -> Path:
    return Path(str(getattr(group.store, "root", ""))) / group.path


def _array_dims(name: str, count: int) -> tuple[str, ...]:
    """Return the dimensions of an array after ``world``."""
    field_name = name.rsplit("/", 1)[-1]
    dims = _DIMS.get(name)
    if dims is None and count == 1 and name.startswith("obstacles/"):
        dims = ("obstacle",)
    if dims is not None and len(dims) == count:
        return dims
    return tuple(f"{field_name}_{i}" for i in range(count))


def _read_group(group: zarr.Group, index: int | slice) -> Environment:
    attributes: Any = group.attrs

    def part(kind: type, prefix: str, **static: Any) -> Any:
        names = [f.name for f in fields(kind) if f.name not in static]
        return kind(**{name: group[prefix + name][index] for name in names}, **static)  # type: ignore[index]

    kinds = [_CURRENTS[name] for name in attributes["current"]]
    field_files = attributes.get("current_file") or [None] * len(kinds)
    files = [
        {} if field_file is None else {"field": _load_field(group, field_file), "numbers": None}
        for field_file in field_files
    ]
    environment: Environment = part(
        Environment,
        "",
        grid=part(Grid, "grid/"),
        obstacles=part(
            Obstacles,
            "obstacles/",
            kinds=tuple(attributes["obstacle_kinds"]),
            motions=tuple(attributes["obstacle_motions"]),
        ),
        current=tuple(
            part(kind, f"current/{i}/", **file)
            for i, (kind, file) in enumerate(zip(kinds, files, strict=True))
        ),
    )
    return environment


def _load_field(group: zarr.Group, metadata: dict[str, str | None]) -> ocean.OceanField:
    """Load the field of the worlds' current, from the run's copy of its file or the file."""
    group_path, source = _group_path(group), str(metadata["file"])
    # Those of a run lie in its trajectories.
    copies = input_copies.stand_ins(group_path.parent.parent) if group.path else {}
    field = ocean.load_field(copies.get((input_copies.OCEAN, source), source), metadata)
    if field.digest != metadata["digest"]:
        raise ConfigError(
            f"{source}: is not the file that these worlds were made with; put that one back"
        )
    return field


def generate_file(
    path: Path,
    config: WorldConfig,
    radius_m: np.ndarray,
    seed: int,
    count: int,
    tile: int = 256,
    advance: Callable[[int], None] = lambda done: None,
) -> int:
    """Generate worlds and write them to a new file; all of it or nothing.

    Args:
        path: of the Zarr group to make.
        config: what to generate.
        radius_m: [n_robot] radius of each robot.
        seed: of the first world's key and all others'.
        count: number of worlds.
        tile: worlds generated at once.
        advance: called with the number of worlds done after each tile.

    Returns:
        How many worlds cannot hold the fleet; they are stored with ``valid`` False.

    Raises:
        ConfigError: the path exists, or the config cannot be used with this fleet.
        RunError: the path cannot be written.
    """
    tile = min(tile, count)
    invalid, done = 0, 0
    with results_folder.build_folder(path, kind="file of environments") as building:
        group = zarr.open_group(building, mode="a")
        for first in range(0, count, tile):
            batch = generate_batch(config, radius_m, seed, first, tile)
            if first == 0:
                create_arrays(group, batch, count, tile)
                group.attrs["world_config"] = config.model_dump(mode="json")
                group.attrs["world_recipe"] = resolve_world(config).model_dump(mode="json")
                group.attrs["radius_m"] = np.asarray(radius_m).tolist()
                group.attrs["seed"] = seed
                require_valid(batch)
            write_batch(group, first, batch)
            done = min(first + tile, count)
            invalid += int(np.sum(~np.asarray(batch.valid)[: done - first]))
            advance(done)
    return invalid


def open_environments(path: Path) -> zarr.Group:
    """Open a file that `generate_file` wrote, or the environments of a run folder.

    Raises:
        ConfigError: there is none, or it is something else.
    """
    inside = path / "trajectories.zarr" / "environment"
    path = inside if inside.exists() else path
    with wrap_read_errors(
        path, "give a file of angler env make, or a run folder with trajectories"
    ):
        group = zarr.open_group(path, mode="r")
        attributes = dict(group.attrs)
    version = attributes.get("schema_version")
    if attributes.get("schema") != "angler_mjx environment" or version != SCHEMA_VERSION:
        raise ConfigError(f"{path}: holds no environments of schema version {SCHEMA_VERSION}")
    with wrap_read_errors(path):
        check_arrays(list_arrays(group), path)
    return group


def named_leaves(tree: Environment | Problem) -> dict[str, jax.Array]:
    """Return the arrays of environments or problems by their names in a group."""
    named = jax.tree_util.tree_flatten_with_path(tree)[0]
    return {keystr(path, simple=True, separator="/"): leaf for path, leaf in named}
