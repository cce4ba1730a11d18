"""Names, dimensions and units of ``trajectories.zarr``, for writer and readers.

What is recorded of a control step is declared in `angler_mjx.sim.record`; here it gets its place.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import cast

import jax
import numpy as np
import zarr
from numpy.typing import ArrayLike
from zarr.types import ArrayV3

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.plans import Plan, of_robot, points_m, trace_path
from angler_mjx.sim.record import ESTIMATE, FIELDS, JOINT_AXIS, SIZES, STATE_FIELDS, TASK
from angler_mjx.world.tasks.history import TaskHistory
from angler_mjx.world.tasks.spec import TaskSpec

END_GROUP = "end"
"""Group of the one state of each world that comes after its last sample."""
ENVIRONMENT_GROUP = "environment"
TIME_ARRAY = "time_s"

YAW_INDEX = VEHICLE_JOINTS.index("yaw")
_BASE = len(VEHICLE_JOINTS)

MAX_SIZE = 10**7
"""Of a dimension of one world: what claims more is damaged."""


@dataclass(frozen=True, kw_only=True)
class ArrayKind:
    """An array of a run."""

    dims: tuple[str, ...]
    """After ``world``."""
    unit: str
    text: str
    dtype: np.dtype | type[np.generic] = np.float32


_JOINT = {"joint": len(VEHICLE_JOINTS)}
_ABSENT = dict.fromkeys(("place", "job", "x", "y", "z", JOINT_AXIS), 0)
_STEP = ArrayKind(
    dims=(),
    unit="1",
    text="control steps until this state, the one after the last sample",
    dtype=np.int32,
)
_PLAN = {
    "plan_time_s": ArrayKind(dims=("robot", "way_point"), unit="s", text="time of each way-point"),
    "plan_m": ArrayKind(
        dims=("robot", "way_point", "xyz"), unit="m", text="way-points, world frame"
    ),
}
_JOINTS = ("robot", "way_point", "joint")
MOTION_ARRAYS = {
    "plan_yaw_rad": ArrayKind(
        dims=("robot", "way_point"), unit="rad", text="heading at each way-point, 0 = east"
    ),
    "plan_velocity": ArrayKind(
        dims=_JOINTS,
        unit="m/s, rad/s",
        text="of x, y, z and heading at each way-point, W",
    ),
    "plan_acceleration": ArrayKind(
        dims=_JOINTS, unit="m/s^2, rad/s^2", text="likewise; 0 where the segments do not use it"
    ),
    "plan_degree": ArrayKind(
        dims=("robot", "way_point"),
        unit="1",
        text="of the polynomial from each way-point on: 1, 3 or 5",
        dtype=np.uint8,
    ),
}
"""Of plans that are trajectories of joints (`JointTrajectory`); way-points alone have none."""
_ARM = ("robot", "way_point", JOINT_AXIS)
ARM_PLAN_ARRAYS = {
    "plan_joint_position": ArrayKind(
        dims=_ARM, unit="rad or m", text="of the joints of arms at each way-point"
    ),
    "plan_joint_velocity": ArrayKind(
        dims=_ARM, unit="rad/s or m/s", text="likewise; 0 where the segments do not use it"
    ),
    "plan_joint_acceleration": ArrayKind(
        dims=_ARM, unit="rad/s^2 or m/s^2", text="likewise; 0 where the segments do not use it"
    ),
}
"""Of plans that move the joints of arms beside the base."""

TASK_ARRAYS = {
    f"{TASK}/place_m": ArrayKind(
        dims=("place", "xyz"),
        unit="m",
        text="places of the task, world frame: where jobs begin, where goods go (deliver alone), "
        "homes of the robots",
    ),
    f"{TASK}/exists": ArrayKind(
        dims=("job",), unit="1", text="1 for the jobs that this world has", dtype=np.uint8
    ),
    f"{TASK}/by": ArrayKind(
        dims=("job",),
        unit="1",
        text="robot that did each job, the last one where all had to; -1: not done",
        dtype=np.int16,
    ),
    f"{TASK}/done_at_s": ArrayKind(dims=("job",), unit="s", text="when; NaN: not done"),
    f"{TASK}/cells": ArrayKind(
        dims=("x", "y", "z"),
        unit="1",
        text="of a survey, cells next to what is surveyed: 1 to be seen, 2 seen, 0 others",
        dtype=np.uint8,
    ),
    f"{TASK}/seen_at_s": ArrayKind(
        dims=("x", "y", "z"),
        unit="s",
        text="of a survey, when a robot saw each cell first; NaN: never, or not to be seen",
    ),
}
"""Of worlds with a task: what it is, and what had been done at the end."""

ARRAYS: dict[str, ArrayKind] = {
    **{
        field.about.array: ArrayKind(
            dims=("time", *field.about.axes),
            unit=field.about.unit,
            text=field.about.text,
            dtype=field.stored,
        )
        for field in FIELDS
    },
    f"{END_GROUP}/step": _STEP,
    **{
        f"{END_GROUP}/{field.about.array}": ArrayKind(
            dims=field.about.axes,
            unit=field.about.unit,
            text=field.about.text,
            dtype=field.stored,
        )
        for field in STATE_FIELDS
    },
    **_PLAN,
    **MOTION_ARRAYS,
    **ARM_PLAN_ARRAYS,
    **TASK_ARRAYS,
}
"""Arrays [world, ...] by their names in the group, in the order in which they are made."""

EARLIER_DTYPES = {"pwm_us": np.uint16}
"""Types that runs of version 0.1.0 have; they have no end either."""


OPTIONAL_ARRAYS = {field.about.array: field.about.option for field in FIELDS if field.about.option}
"""By which word arrays are asked for that only some runs have."""


def array_names(
    sizes: Mapping[str, int],
    *,
    estimated: bool,
    jointed: bool = False,
    armed: bool = False,
    also: Sequence[str] = (),
) -> list[str]:
    """Return the arrays of a run, without those that are always empty.

    Args:
        sizes: of the dimensions that differ from run to run; those of a task where there is one.
        estimated: whether any robot's controllers were told something other than the truth.
        jointed: whether the plans are trajectories of joints.
        armed: whether they move the joints of arms too.
        also: what the run asked for beside what all have.
    """
    return [
        name
        for name, kind in ARRAYS.items()
        if (estimated or not name.startswith(f"{ESTIMATE}/"))
        and (jointed or name not in MOTION_ARRAYS)
        and (armed or name not in ARM_PLAN_ARRAYS)
        and (name not in OPTIONAL_ARRAYS or OPTIONAL_ARRAYS[name] in also)
        and (sizes.get("job", 0) > 0 or not name.startswith(f"{TASK}/"))
        and 0 not in array_shape(kind, sizes)
    ]


def array_shape(kind: ArrayKind, sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Return the shape of a kind of array after the worlds."""
    return tuple({**SIZES, **_JOINT, **_ABSENT, **sizes}[dim] for dim in kind.dims)


def check_layout(
    arrays: Mapping[str, ArrayV3],
    source: str,
    *,
    worlds: int,
    robots: int,
    estimated: bool,
    also: Sequence[str] = (),
    tasked: bool = False,
    joints: int = 0,
) -> None:
    """Refuse trajectories that are not those of a run, before anything of them is read.

    Args:
        arrays: of the Zarr group, by their names.
        source: it lies, for messages.
        worlds: of the run.
        robots: of its fleet.
        estimated: as in `array_names`.
        also: likewise.
        tasked: whether there is a task.
        joints: of a vehicle of the fleet, at most; flights on real autopilots record none.

    Raises:
        ConfigError: an array is missing, or has another shape or type.
    """
    time = arrays[TIME_ARRAY]
    if time.ndim != 1 or not 1 <= time.size <= MAX_SIZE or time.dtype.kind != "f":
        raise ConfigError(
            f"{source}/{TIME_ARRAY}: has the shape {time.shape} of {time.dtype}, not [time]"
        )
    sizes = {"time": time.size, "robot": robots}
    for name, dim in (("plan_time_s", "way_point"), ("pwm_us", "thruster")):
        sizes[dim] = _dimension_size(arrays, name, -1, source)
    sizes["obstacle"] = (
        _dimension_size(arrays, "obstacle_p_m", -2, source) if "obstacle_p_m" in arrays else 0
    )
    has_arm_plan = not ARM_PLAN_ARRAYS.keys().isdisjoint(arrays)
    sizes[JOINT_AXIS] = joints if has_arm_plan or "joint_position" in arrays else 0
    if tasked:
        sizes |= {
            "place": _dimension_size(arrays, f"{TASK}/place_m", -2, source),
            "job": _dimension_size(arrays, f"{TASK}/by", -1, source),
        }
        if f"{TASK}/cells" in arrays:
            for axis, dim in enumerate("xyz"):
                sizes[dim] = _dimension_size(arrays, f"{TASK}/cells", axis - 3, source)
    has_end = any(name.startswith(f"{END_GROUP}/") for name in arrays)
    has_joints = not MOTION_ARRAYS.keys().isdisjoint(arrays)
    for name in array_names(
        sizes, estimated=estimated, jointed=has_joints, armed=has_arm_plan, also=also
    ):
        if name.startswith(f"{END_GROUP}/") and not has_end:
            continue
        if name not in arrays:
            raise ConfigError(f"{source}/{name}: is missing; copy it again, or make the run anew")
        array, kind = arrays[name], ARRAYS[name]
        expected = (worlds, *array_shape(kind, sizes))
        has_dtype = array.dtype in (kind.dtype, EARLIER_DTYPES.get(name, kind.dtype))
        if array.shape != expected or not has_dtype or array.chunks != (1, *expected[1:]):
            raise ConfigError(
                f"{source}/{name}: is described as {array.dtype} {array.shape} in chunks of "
                f"{array.chunks}, and should be {np.dtype(kind.dtype)} {expected} in chunks of one "
                "world; copy its zarr.json again, or make the run anew"
            )


def _dimension_size(arrays: Mapping[str, ArrayV3], name: str, axis: int, source: str) -> int:
    if name not in arrays:
        raise ConfigError(f"{source}/{name}: is missing; copy it again, or make the run anew")
    shape = arrays[name].shape
    size = int(shape[axis]) if len(shape) >= -axis else -1
    if not 1 <= size <= MAX_SIZE:
        raise ConfigError(f"{source}/{name}: has the shape {shape}; copy its zarr.json again")
    return size


def plan_arrays(plan: Plan) -> dict[str, jax.Array]:
    """Return the arrays of a plan by their names on disk, with its leading axes."""
    arrays = {"plan_time_s": plan.time_s, "plan_m": points_m(plan)}
    if isinstance(plan, JointTrajectory):
        arrays |= {
            "plan_yaw_rad": plan.position[..., YAW_INDEX],
            "plan_velocity": plan.velocity[..., :_BASE],
            "plan_acceleration": plan.acceleration[..., :_BASE],
            "plan_degree": plan.degree,
        }
        if len(plan.joints) > _BASE:
            arrays |= {
                "plan_joint_position": plan.position[..., _BASE:],
                "plan_joint_velocity": plan.velocity[..., _BASE:],
                "plan_joint_acceleration": plan.acceleration[..., _BASE:],
            }
    return arrays


def plan_courses(stored: zarr.Group, world: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return the course of each robot's plan in a world, for pictures (`robot.control.plans`)."""
    robots = stored.get_array("plan_time_s").shape[1]
    plan = read_plan(stored, world, np.ones(robots, bool))
    return [trace_path(of_robot(plan, i)) for i in range(robots)]


def read_plan(stored: zarr.Group, world: int, is_found: ArrayLike) -> Plan:
    """Read the plan of a world, the same numbers that were flown, in float32.

    Args:
        stored: a run's trajectories.
        world: global index.
        is_found: bool [R] whether the planner found a way for each robot.

    Returns:
        Arrays of NumPy, [R] leading.
    """

    def read_array(name: str, dtype: type[np.generic] | None = None) -> jax.Array:
        return host_leaf(np.asarray(stored.get_array(name)[world], dtype))

    time_s, points = read_array("plan_time_s"), read_array("plan_m")
    found = host_leaf(np.asarray(is_found, bool))
    if "plan_degree" not in stored:
        return Trajectory(time_s=time_s, position_m=points, found=found)
    yaw = np.asarray(read_array("plan_yaw_rad"))
    columns = {
        "position": np.concatenate([points, yaw[..., None]], axis=-1),
        "velocity": read_array("plan_velocity"),
        "acceleration": read_array("plan_acceleration"),
    }
    names = plan_joint_names(stored)
    if names:
        for name, base in columns.items():
            columns[name] = np.concatenate([base, read_array(f"plan_joint_{name}")], axis=-1)
    joints = (*VEHICLE_JOINTS, *names)
    return JointTrajectory(
        joints=joints,
        time_s=time_s,
        **{name: host_leaf(np.asarray(values)) for name, values in columns.items()},
        degree=read_array("plan_degree", np.int32),
        commanded=host_leaf(np.ones((len(points), len(joints)), bool)),
        found=found,
    )


def plan_joint_names(stored: zarr.Group) -> tuple[str, ...]:
    """Return the names of the joints of arms that the plans of a run move; none if they do not."""
    if "plan_joint_position" not in stored:
        return ()
    vehicles = cast(
        dict[str, list[dict[str, str]]],
        stored.get_array("plan_joint_position").attrs["joints"],
    )
    longest = max(vehicles.values(), key=len)
    return tuple(joint["name"] for joint in longest)


def host_leaf(values: np.ndarray) -> jax.Array:
    """Return an array of the host by the type of the leaves of plans, which are of either kind."""
    return cast(jax.Array, values)


def read_task(
    stored: zarr.Group,
    world: int,
    spec: TaskSpec,
    *,
    samples: int,
    ended_s: np.ndarray,
    completed_s: float | None,
) -> TaskHistory:
    """Read the progress of a world's task over time.

    Args:
        stored: a run's trajectories.
        world: global index.
        spec: settings of the task.
        samples: how many are wanted, from the first.
        ended_s: [R] when the episode of each robot was over.
        completed_s: when the task was complete; None: never.
    """

    def read_array(name: str) -> np.ndarray:
        return np.asarray(stored.get_array(f"{TASK}/{name}")[world])

    def read_samples(name: str, dtype: type = int) -> np.ndarray:
        return np.asarray(stored.get_array(f"{TASK}/{name}")[world, :samples], dtype)

    is_survey = f"{TASK}/cells" in stored
    return TaskHistory(
        spec=spec,
        time_s=np.asarray(stored.get_array(TIME_ARRAY)[:samples], float),
        position_m=read_array("place_m"),
        exists=read_array("exists").astype(bool),
        by=read_array("by").astype(int),
        done_at_s=read_array("done_at_s"),
        progress=read_samples("share", float),
        did=read_samples("done"),
        target=read_samples("target"),
        carrying=read_samples("carrying"),
        ended_s=ended_s,
        completed_s=np.nan if completed_s is None else completed_s,
        cells=read_array("cells") > 0 if is_survey else None,
        seen_at_s=read_array("seen_at_s") if is_survey else None,
    )
