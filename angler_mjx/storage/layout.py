"""What lies in ``trajectories.zarr``: names, dimensions and units, for writer and readers."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.errors import ConfigError

ESTIMATE = "estimate"
"""Group of what the controllers were told, where that was not the truth."""
END = "end"
"""Group of the one state of each world that comes after its last sample."""
ENVIRONMENT = "environment"
TIME = "time_s"

WIDTHS = {"axis": 3, "quaternion": 4, "velocity_axis": 6}
"""Sizes of dimensions that are the same in every run."""
MOST = 10**7
"""Of a dimension of one world: what claims more is damaged."""


@dataclass(frozen=True, kw_only=True)
class Kind:
    """An array of a run."""

    dims: tuple[str, ...]
    """After ``world``."""
    unit: str
    text: str
    dtype: type = np.float32


def _sampled(unit: str, text: str, *dims: str, dtype: type = np.float32) -> Kind:
    return Kind(dims=("time", *dims), unit=unit, text=text, dtype=dtype)


ARRAYS: dict[str, Kind] = {
    "p_m": _sampled(
        "m",
        "centre of mass, world frame (x east, y north, z up, 0 at the surface)",
        "robot",
        "axis",
    ),
    "q": _sampled(
        "1",
        "attitude, quaternion wxyz, body (forward, left, up) to world",
        "robot",
        "quaternion",
    ),
    "nu": _sampled(
        "m/s, rad/s",
        "velocity over ground [u v w p q r], body frame",
        "robot",
        "velocity_axis",
    ),
    "target_m": _sampled("m", "where the controller aims, world frame", "robot", "axis"),
    "current_mps": _sampled("m/s", "water velocity at the robot, world frame", "robot", "axis"),
    "pwm_us": _sampled(
        "us",
        "command of each thruster; 1500 in padding columns, 0 where a diverged robot had none",
        "robot",
        "thruster",
        dtype=np.uint16,
    ),
    "outcome": _sampled(
        "1",
        "0 running, 1 reached, 2 collision_static, 3 collision_dynamic, "
        "4 collision_robot, 5 out_of_bounds, 6 timeout, 7 diverged",
        "robot",
        dtype=np.uint8,
    ),
    "obstacle_p_m": _sampled("m", "centre of each obstacle, world frame", "obstacle", "axis"),
    "obstacle_q": _sampled(
        "1",
        "attitude of each obstacle, quaternion wxyz, body to world",
        "obstacle",
        "quaternion",
    ),
    f"{ESTIMATE}/p_m": _sampled(
        "m", "centre of mass as the controllers were told it, world frame", "robot", "axis"
    ),
    f"{ESTIMATE}/q": _sampled(
        "1", "attitude as they were told it, quaternion wxyz, body to world", "robot", "quaternion"
    ),
    f"{ESTIMATE}/nu": _sampled(
        "m/s, rad/s",
        "velocity over ground as they were told it, body frame",
        "robot",
        "velocity_axis",
    ),
    f"{ESTIMATE}/position_std_m": _sampled(
        "m",
        "standard deviations of the estimate, world frame; 0 for the truth",
        "robot",
        "axis",
    ),
    f"{ESTIMATE}/velocity_std_mps": _sampled(
        "m/s", "standard deviations of the velocity, world frame", "robot", "axis"
    ),
    f"{ESTIMATE}/attitude_std_rad": _sampled(
        "rad", "standard deviations of the attitude, about the world's axes", "robot", "axis"
    ),
    "plan_time_s": Kind(dims=("robot", "way_point"), unit="s", text="time of each way-point"),
    "plan_m": Kind(dims=("robot", "way_point", "axis"), unit="m", text="way-points, world frame"),
}
"""Arrays [world, ...] by their names in the group, in the order in which they are made."""


def names(sizes: Mapping[str, int], *, estimated: bool) -> list[str]:
    """Arrays of a run; those in which nothing could lie are left out.

    Args:
        sizes: of the dimensions that differ from run to run.
        estimated: whether any robot's controllers were told something other than the truth.
    """
    return [
        name
        for name, kind in ARRAYS.items()
        if (estimated or not name.startswith(f"{ESTIMATE}/")) and 0 not in tail(kind, sizes)
    ]


def tail(kind: Kind, sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Shape of a kind of array after the worlds."""
    return tuple((WIDTHS | dict(sizes))[dim] for dim in kind.dims)


def check(
    nodes: Mapping[str, Any], where: str, *, worlds: int, robots: int, estimated: bool
) -> None:
    """Refuse trajectories that are not those of a run, before anything of them is read.

    Args:
        nodes: of the Zarr group, by their names.
        where: it lies, for messages.
        worlds: of the run.
        robots: of its fleet.
        estimated: as in `names`.

    Raises:
        ConfigError: an array is missing, or has another shape or type.
    """
    time = nodes[TIME]
    if time.ndim != 1 or not 1 <= time.size <= MOST or time.dtype.kind != "f":
        raise ConfigError(f"{where}/{TIME}: has the shape {time.shape} of {time.dtype}, not [time]")
    sizes = {"time": time.size, "robot": robots}
    for name, dim in (("plan_time_s", "way_point"), ("pwm_us", "thruster")):
        sizes[dim] = _size(nodes, name, -1, where)
    sizes["obstacle"] = _size(nodes, "obstacle_p_m", -2, where) if "obstacle_p_m" in nodes else 0
    for name in names(sizes, estimated=estimated):
        if name not in nodes:
            raise ConfigError(f"{where}/{name}: is missing; copy it again, or make the run anew")
        array, kind = nodes[name], ARRAYS[name]
        wanted = (worlds, *tail(kind, sizes))
        if array.shape != wanted or array.dtype != kind.dtype or array.chunks != (1, *wanted[1:]):
            raise ConfigError(
                f"{where}/{name}: is described as {array.dtype} {array.shape} in chunks of "
                f"{array.chunks}, and should be {np.dtype(kind.dtype)} {wanted} in chunks of one "
                "world; copy its zarr.json again, or make the run anew"
            )


def _size(nodes: Mapping[str, Any], name: str, axis: int, where: str) -> int:
    if name not in nodes:
        raise ConfigError(f"{where}/{name}: is missing; copy it again, or make the run anew")
    shape = nodes[name].shape
    size = int(shape[axis]) if len(shape) >= -axis else -1
    if not 1 <= size <= MOST:
        raise ConfigError(f"{where}/{name}: has the shape {shape}; copy its zarr.json again")
    return size
