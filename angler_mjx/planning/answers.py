"""Answers of planners on the host, and the check of their paths before the flight.

A path with a wrong number of points, NaN, jumps or too high a speed is refused with a reason; the
paths of other robots remain. Collisions are not checked: the flight shows them.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np

from angler_mjx.errors import format_value
from angler_mjx.planning.planner import MAX_POINTS, NoPlan, Path
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.joint_trajectory import (
    CUBIC,
    LINEAR,
    QUINTIC,
    VEHICLE_JOINTS,
    JointState,
    JointTrajectory,
    interpolate_segment,
)
from angler_mjx.robot.control.commands.trajectory import Trajectory

type Status = Literal["planned", "partial", "none", "timeout", "error", "died"]
"""All robots have a path; some; none; it took too long; it threw; its process died, twice."""

START_M = 0.01
"""How far from the robot's start a path may begin."""

START_JOINT = 0.01
"""How far, rad or m, from its start, or beyond its limits, a joint of an arm may be."""

SPEED_TOLERANCE = 0.01
"""Fraction by which a path may exceed the robot's cruise speed, for rounding."""

ROUNDING_M = 1e-4
"""How much farther than that two points may lie apart: float32 of places and times."""

ROUNDING_S = 1e-3
"""How much after the horizon a path may end."""

MAX_PROGRESS_POINTS = 1000
"""Limit of better paths that a planner can report."""

SPEED_SAMPLES = 32
"""Times within a segment at which the speed along a curve is checked."""


@dataclass(frozen=True, kw_only=True)
class Answer:
    """To one problem."""

    paths: list[Path | NoPlan]
    """One of each robot; arrays of NumPy: float32, degrees int32, ``found`` and ``commanded``
    bool."""
    status: Status
    reason: str
    """Why not all robots have a path; empty where they have."""
    planning_s: float
    """Wall time inside ``plan``; until it was ended where it was."""
    extras: dict[str, float] = field(default_factory=dict)
    """Further numbers that the planner reports on this problem, by name."""
    progress: tuple[tuple[float, float], ...] = ()
    """Each time that the planner had a better path: seconds since its search began, and the cost of
    that path, in a measure of its own."""


FAILED_STATUSES = ("error", "died", "timeout")
"""Statuses of problems for which the planner raised, died or gave no answer in time."""


def check_answer(
    returned: object,
    problem: Problem,
    planning_s: float,
    extras: object,
    max_points: int = MAX_POINTS,
    progress: object = None,
    *,
    any_speed: bool = False,
) -> Answer:
    """Return the flyable part of an answer; an answer that is no list of paths is an error.

    Args:
        returned: any value that ``plan`` returned.
        problem: of the answer.
        planning_s: wall time inside ``plan``.
        extras: of the planner, a mapping of names to numbers; others are left out.
        max_points: of one path.
        progress: of the planner, a sequence of pairs of a time, s, and a cost, in order of time;
            what is not so is left out, and what is more than `MAX_PROGRESS_POINTS`.
        any_speed: paths may be faster over ground than the robot cruises, as those of planners are
            that count on a current.
    """
    listed = _list_paths(returned, problem.robots)
    if isinstance(listed, str):
        return failed_answer(problem.robots, "error", listed, planning_s)
    paths = check_paths(returned, problem, max_points, any_speed=any_speed)
    missing = [(i, path.reason) for i, path in enumerate(paths) if isinstance(path, NoPlan)]
    reasons = {reason for _, reason in missing}
    if len(missing) == len(paths) and len(reasons) == 1:
        reason = reasons.pop()
    else:
        reason = "; ".join(f"robot {i}: {reason}" for i, reason in missing)
    status: Status = "planned" if not missing else "partial"
    return Answer(
        paths=paths,
        status="none" if len(missing) == len(paths) else status,
        reason=reason,
        planning_s=planning_s,
        extras=_select_numbers(extras),
        progress=_select_progress(progress),
    )


def failed_answer(robots: int, status: Status, reason: str, planning_s: float) -> Answer:
    """Return the answer in which no robot has a path, all for one reason."""
    paths: list[Path | NoPlan] = [NoPlan(reason) for _ in range(robots)]
    return Answer(paths=paths, status=status, reason=reason, planning_s=planning_s)


def check_paths(
    returned: object, problem: Problem, max_points: int = MAX_POINTS, *, any_speed: bool = False
) -> list[Path | NoPlan]:
    """Return for each robot a flyable path or the reason for none.

    Args:
        returned: any value that a planner's ``plan`` returned.
        problem: of the answer, in arrays of NumPy.
        max_points: of one path.
        any_speed: see `check_answer`.
    """
    listed = _list_paths(returned, problem.robots)
    if isinstance(listed, str):
        return [NoPlan(listed)] * problem.robots
    return [
        _check_path(path, problem, robot, max_points, any_speed)
        for robot, path in enumerate(listed)
    ]


def _list_paths(returned: object, robots: int) -> Sequence[object] | str:
    """Return the paths of a planner's answer, or why it is no list of a path for each robot."""
    if not isinstance(returned, Sequence) or isinstance(returned, str | bytes):
        return f"gave no list of paths but {type(returned).__name__}"
    if len(returned) != robots:
        return f"gave {len(returned)} paths for {robots} robots"
    return returned


class _RefusedError(Exception):
    """A path cannot be flown; its text is the reason."""


def _check_path(
    path: object, problem: Problem, robot: int, max_points: int, any_speed: bool
) -> Path | NoPlan:
    try:
        match path:
            case NoPlan():
                return NoPlan(str(path.reason))
            case Trajectory():
                checked: Path = _check_trajectory(path, max_points)
            case JointTrajectory():
                checked = _check_joint_trajectory(path, problem, max_points)
            case _:
                raise _RefusedError(f"no path but {type(path).__name__}")
        _check_motion(checked, problem, robot, any_speed)
    except _RefusedError as error:
        return NoPlan(str(error))
    return checked


def _check_trajectory(path: Trajectory, max_points: int) -> Trajectory:
    time = _check_times(path.time_s, max_points)
    position = _check_array("points", path.position_m, (len(time), 3))
    if not bool(_check_array("found", path.found, (), bool)):
        raise _RefusedError("no way was found")
    return Trajectory(time_s=time, position_m=position, found=_check_array("found", True, (), bool))


def _check_joint_trajectory(
    path: JointTrajectory, problem: Problem, max_points: int
) -> JointTrajectory:
    joints, with_arm = tuple(path.joints), (*VEHICLE_JOINTS, *problem.joint_names)
    if joints not in (VEHICLE_JOINTS, with_arm):
        expected = " or ".join(
            format_value(names) for names in dict.fromkeys((VEHICLE_JOINTS, with_arm))
        )
        raise _RefusedError(f"has the joints {format_value(path.joints)}, not {expected}")
    time = _check_times(path.time_s, max_points)
    shape = (len(time), len(joints))
    degree = _check_array("degrees", path.degree, shape[:1])
    if not np.all(np.isin(degree, (LINEAR, CUBIC, QUINTIC))):
        raise _RefusedError("has segments of a degree that is not 1, 3 or 5")
    return JointTrajectory(
        joints=joints,
        time_s=time,
        position=_check_array("points", path.position, shape),
        velocity=_check_array("velocities", path.velocity, shape),
        acceleration=_check_array("accelerations", path.acceleration, shape),
        degree=degree.astype(np.int32),
        commanded=_check_array("commanded", path.commanded, shape[1:], bool),
    )


def _check_times(values: object, max_points: int) -> Any:
    time = _check_array("times", values, None)
    if time.ndim != 1:
        raise _RefusedError(f"has times of shape {list(time.shape)}, not [n]")
    if len(time) < 2:
        raise _RefusedError(f"has {len(time)} points; at least 2 are needed")
    if len(time) > max_points:
        raise _RefusedError(f"has {len(time)} points; at most {max_points} can be flown")
    if time[0] != 0.0:
        raise _RefusedError(f"begins at {time[0]:.3g} s, not at 0")
    back = np.flatnonzero(np.diff(time) < 0)
    if len(back):
        at = back[0]
        raise _RefusedError(
            f"goes back in time from {time[at]:.3g} to {time[at + 1]:.3g} s at point {at + 1}"
        )
    return time


def _check_array(
    name: str, values: object, shape: tuple[int, ...] | None, kind: type = np.float32
) -> Any:
    """Return values as NumPy's array of a shape (None: any) and type; all must be finite."""
    try:
        array = np.asarray(values)
        if array.dtype.kind not in "biuf":
            raise _RefusedError(f"has {name} that are no numbers but {array.dtype}")
        array = array.astype(kind)
    except (TypeError, ValueError) as error:
        raise _RefusedError(f"has {name} that are no array: {error}") from error
    if shape is not None and array.shape != shape:
        raise _RefusedError(f"has {name} of shape {list(array.shape)}, not {list(shape)}")
    bad = np.argwhere(~np.isfinite(array))
    if len(bad):
        where = f" at point {bad[0][0]}" if array.ndim else ""
        raise _RefusedError(f"has NaN or infinite {name}{where}")
    return array


def _check_motion(path: Path, problem: Problem, robot: int, any_speed: bool) -> None:
    """Start, end and speed of a path whose arrays are sound."""
    time = np.asarray(path.time_s, np.float64)
    points = path.position_m if isinstance(path, Trajectory) else path.position[:, :3]
    position_m = np.asarray(points, np.float64)
    start_error_m = np.linalg.norm(position_m[0] - np.asarray(problem.team.start_m)[robot])
    if start_error_m > START_M:
        raise _RefusedError(f"begins {start_error_m:.3g} m from the robot's start")
    if time[-1] > problem.horizon_s + ROUNDING_S:
        raise _RefusedError(f"ends at {time[-1]:.4g} s, after the horizon of {problem.horizon_s:g}")
    cruise = float(np.asarray(problem.team.cruise_speed_mps)[robot])
    span, length_m = np.diff(time), np.linalg.norm(np.diff(position_m, axis=0), axis=1)
    max_length_m = np.where(
        any_speed & (span > 0.0), np.inf, (1.0 + SPEED_TOLERANCE) * cruise * span
    )
    too_fast = np.flatnonzero(length_m > max_length_m + ROUNDING_M)
    if len(too_fast):
        at = too_fast[0]
        if span[at] == 0.0:
            raise _RefusedError(f"jumps {length_m[at]:.3g} m at {time[at]:.4g} s (point {at + 1})")
        _reject_speed(length_m[at] / span[at], cruise, at, time)
    if isinstance(path, JointTrajectory) and not any_speed:
        _check_curve_speeds(path, cruise, time)
    if isinstance(path, JointTrajectory) and len(path.joints) > len(VEHICLE_JOINTS):
        _check_arm(path, problem, robot)


def _check_arm(path: JointTrajectory, problem: Problem, robot: int) -> None:
    """Check start, limits and speeds of the joints of an arm at the points of a path."""
    arms = problem.team.arms
    assert arms is not None
    links, first = arms.links, len(VEHICLE_JOINTS)
    position = np.asarray(path.position, np.float64)[:, first:]
    lower, upper, max_speed = (
        np.asarray(values)[robot] for values in (links.lower, links.upper, links.max_speed)
    )
    outside = (position < lower - START_JOINT) | (position > upper + START_JOINT)
    span = np.diff(np.asarray(path.time_s, np.float64))[:, None]
    moved = np.abs(np.diff(position, axis=0))
    too_fast = moved > (1.0 + SPEED_TOLERANCE) * max_speed * span + ROUNDING_M
    off_start = np.abs(position[0] - np.asarray(arms.joint_position)[robot]) > START_JOINT
    for bad, fault in (
        (off_start, "begins elsewhere than it is"),
        (outside.any(axis=0), "goes beyond its limits"),
        (too_fast.any(axis=0), "moves faster than it can"),
    ):
        if bad.any():
            raise _RefusedError(f"joint {problem.joint_names[int(np.argmax(bad))]} {fault}")


def _check_curve_speeds(path: JointTrajectory, cruise: float, time: np.ndarray) -> None:
    """Check speeds within the segments that are bent."""
    bent = np.flatnonzero((np.asarray(path.degree)[:-1] > LINEAR) & (np.diff(time) > 0))
    if not len(bent):
        return
    states: list[Any] = [
        np.asarray(values, np.float64)[:, None, :3]
        for values in (path.position, path.velocity, path.acceleration)
    ]
    begin, end = (
        JointState(position=p[rows], velocity=v[rows], acceleration=a[rows])
        for rows in (bent, bent + 1)
        for p, v, a in [states]
    )
    span: Any = (time[bent + 1] - time[bent])[:, None, None]
    fraction: Any = np.linspace(0.0, 1.0, SPEED_SAMPLES + 1)[None, :, None]
    degree: Any = np.asarray(path.degree)[bent][:, None, None]
    moving = interpolate_segment(begin, end, span, fraction, degree)
    speed = np.linalg.norm(np.asarray(moving.velocity), axis=-1).max(axis=-1)
    allowed = (1.0 + SPEED_TOLERANCE) * cruise + ROUNDING_M / span[:, 0, 0]
    too_fast = np.flatnonzero(speed > allowed)
    if len(too_fast):
        _reject_speed(speed[too_fast[0]], cruise, bent[too_fast[0]], time)


def _reject_speed(speed: float, cruise: float, at: int, time: np.ndarray) -> None:
    raise _RefusedError(
        f"moves at {speed:.3g} m/s after {time[at]:.4g} s (points {at} and {at + 1}); "
        f"at most {cruise:.3g} m/s, its cruise speed"
    )


def _select_numbers(extras: object) -> dict[str, float]:
    if not isinstance(extras, dict):
        return {}
    return {
        str(name): float(value)
        for name, value in extras.items()
        if isinstance(value, int | float | np.number) and not isinstance(value, bool)
    }


def _select_progress(progress: object) -> tuple[tuple[float, float], ...]:
    if not isinstance(progress, Sequence):
        return ()
    pairs: list[tuple[float, float]] = []
    for pair in progress:
        try:
            time_s, cost = (float(value) for value in pair)
        except (TypeError, ValueError):
            continue
        last_s = pairs[-1][0] if pairs else 0.0
        if (
            time_s >= last_s
            and np.isfinite([time_s, cost]).all()
            and len(pairs) < MAX_PROGRESS_POINTS
        ):
            pairs.append((time_s, cost))
    return tuple(pairs)
