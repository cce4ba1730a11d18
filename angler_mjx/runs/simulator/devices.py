"""Devices of a simulation: a 1-D mesh of tiles, and their memory.

Worlds are independent, so a device runs the program of one tile for any number of devices:
`shard_function` wraps that program in ``shard_map`` and XLA has nothing to divide.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import jax
import numpy as np
import psutil
from jax.sharding import AxisType, Mesh, NamedSharding, PartitionSpec

from angler_mjx.errors import ConfigError, RunError, format_bytes

AXIS = "worlds"
SHARDED = PartitionSpec(AXIS)
"""Sharding of a leaf whose leading axis is spread over the devices."""
REPLICATED = PartitionSpec()
"""Sharding of a leaf that every device holds whole."""

USABLE_FRACTION = 0.95
"""Fraction of the memory limit that a suggested tile fills: allocation leaves gaps."""


def build_mesh(devices: int | None) -> Mesh:
    """Return the mesh of devices of this process.

    Args:
        devices: number of devices; all if None.

    Raises:
        ConfigError: the process has fewer devices.
    """
    local_devices = jax.local_devices()
    count = len(local_devices) if devices is None else devices
    if not 1 <= count <= len(local_devices):
        raise ConfigError(
            f"--devices {count}: there {'is' if len(local_devices) == 1 else 'are'} "
            f"{len(local_devices)} "
            f"({local_devices[0].device_kind}) here; give 1 to {len(local_devices)}"
        )
    return jax.make_mesh(
        (count,), (AXIS,), axis_types=(AxisType.Auto,), devices=local_devices[:count]
    )


def shard_function[F: Callable[..., object]](mesh: Mesh, function: F, *specs: PartitionSpec) -> F:
    """Return ``function`` of one tile as a function of one tile per device.

    Args:
        mesh: mesh from `build_mesh`.
        function: function of arrays; the results' leading axis is that of the tile's worlds.
        *specs: ``SHARDED`` or ``REPLICATED`` for each argument.
    """
    # No check of varying values over the mesh: loop carries begin as constants in the engines.
    return jax.shard_map(function, mesh=mesh, in_specs=specs, out_specs=SHARDED, check_vma=False)


def with_sharding[T](tree: T, mesh: Mesh, spec: PartitionSpec) -> T:
    """Return shapes with their future sharding."""
    sharding = NamedSharding(mesh, spec)
    shapes: T = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=sharding), tree
    )
    return shapes


def split_shards[T](tree: T, count: int) -> list[T]:
    """Return the parts of a sharded tree on the first ``count`` devices, in the order of the mesh.

    The copies to the host have begun when this returns; ``np.asarray`` of a leaf waits for its own.
    """
    leaves, structure = jax.tree.flatten(tree)
    columns: list[list[jax.Array]] = [[] for _ in range(count)]
    for leaf in leaves:
        parts = sorted(leaf.addressable_shards, key=lambda part: part.index[0].start or 0)
        for column, part in zip(columns, parts, strict=False):
            part.data.copy_to_host_async()
            column.append(part.data)
    return [jax.tree.unflatten(structure, column) for column in columns]


@dataclass(frozen=True, kw_only=True)
class DeviceMemory:
    """Memory of one device for its tile, in bytes."""

    prepare: int
    """Bytes during preparation of worlds, with the held data of the previous tile."""
    segment: int
    """Bytes during a segment, with the samples of the previous one."""

    @property
    def needed(self) -> int:
        """Return the peak."""
        return max(self.prepare, self.segment)


class _MemoryReport(Protocol):
    """Memory of one program as XLA reports it, bytes."""

    argument_size_in_bytes: int
    output_size_in_bytes: int
    temp_size_in_bytes: int
    alias_size_in_bytes: int


def analyse_memory(
    prepare: jax.stages.Compiled, reset: jax.stages.Compiled, segment: jax.stages.Compiled
) -> DeviceMemory | None:
    """Return the memory of the compiled functions as reported by XLA; None without a report."""
    reports: list[_MemoryReport | None] = [
        function.memory_analysis() for function in (prepare, reset, segment)
    ]
    prepare_stats, reset_stats, segment_stats = reports
    if prepare_stats is None or reset_stats is None or segment_stats is None:
        return None
    worlds, state = prepare_stats.output_size_in_bytes, reset_stats.output_size_in_bytes
    sample = segment_stats.output_size_in_bytes - segment_stats.alias_size_in_bytes
    return DeviceMemory(
        prepare=_total_bytes(prepare_stats) + worlds + state + 2 * sample,
        segment=_total_bytes(segment_stats) + sample,
    )


def limit_bytes(device: jax.Device) -> int:
    """Return the memory limit of one device: its own, or the machine's."""
    stats = device.memory_stats() or {}
    return int(stats.get("bytes_limit") or psutil.virtual_memory().total)


def require_memory(held_bytes: int) -> None:
    """Refuse program constants of all worlds that fill a device.

    Args:
        held_bytes: bytes of constants in each of the three programs of a run.

    Raises:
        ConfigError: they exceed a quarter of a device's memory.
    """
    limit = limit_bytes(jax.local_devices()[0])
    if 3 * held_bytes > limit // 4:
        raise ConfigError(
            f"world.currents: the fields of files take {format_bytes(held_bytes)} in each of three "
            "programs, "
            f"and a device has {format_bytes(limit)}, a quarter of which is for them: take fewer "
            "depths or "
            "times, or a smaller area (see docs/how_to/ocean.md)"
        )


def largest_tile(tile: int, needed: int, limit: int) -> int:
    """Return the largest tile that fits, memory being proportional to the worlds."""
    return max(int(tile * USABLE_FRACTION * limit / max(needed, 1)), 0)


def tile_too_large(tile: int, needed: int | None, limit: int, cause: str) -> RunError:
    """Return the error that names the largest fitting tile."""
    max_tile = 0 if needed is None else min(largest_tile(tile, needed, limit), tile - 1)
    need_text = "" if needed is None else f", {format_bytes(needed)} a device are needed"
    advice = (
        f"the largest tile that fits is about {max_tile} worlds"
        if max_tile
        else f"not one world is sure to fit; try a tile smaller than {tile}"
    )
    return RunError(
        f"--tile {tile}: out of device memory ({cause}): a device has "
        f"{format_bytes(limit)}{need_text}; "
        f"{advice}; the tile of an interrupted run cannot change, so begin a new one for that"
    )


def is_out_of_memory(error: BaseException) -> bool:
    """Return whether a run-time error of JAX reports exhausted device memory."""
    return isinstance(error, jax.errors.JaxRuntimeError) and "RESOURCE_EXHAUSTED" in str(error)


def tree_bytes(tree: object) -> int:
    """Return the size of a tree of shapes."""
    return sum(
        int(np.prod(leaf.shape)) * np.dtype(leaf.dtype).itemsize for leaf in jax.tree.leaves(tree)
    )


def _total_bytes(part: _MemoryReport) -> int:
    whole = part.argument_size_in_bytes + part.output_size_in_bytes + part.temp_size_in_bytes
    return int(whole - part.alias_size_in_bytes)
