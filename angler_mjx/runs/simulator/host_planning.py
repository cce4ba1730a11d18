"""Planning on the host: problems to worker processes, answers back to worlds.

The device simulates one device batch of worlds while the workers plan the next.
"""

import os
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import TYPE_CHECKING

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.planning import register
from angler_mjx.planning.answers import FAILED_STATUSES, Answer
from angler_mjx.planning.planner import NoPlan, Path, PathShape
from angler_mjx.planning.problem import Problem, ProblemName
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.sim.state import World

if TYPE_CHECKING:
    from angler_mjx.planning.host.workers import Workers


@dataclass(frozen=True, kw_only=True)
class PlanNotes:
    """Status and duration of the planning of some worlds; arrays of NumPy."""

    planning_s: np.ndarray
    """[w] wall-clock time [s] of the planner; NaN if unknown."""
    status: np.ndarray
    """[w] text: a status of `angler_mjx.planning.answers`."""
    reason: np.ndarray
    """[w, r] text: reason why a robot has no path; empty with a path."""

    def rows(self, chosen: slice) -> "PlanNotes":
        """Return the notes of some of the worlds."""
        return PlanNotes(
            planning_s=self.planning_s[chosen],
            status=self.status[chosen],
            reason=self.reason[chosen],
        )


def split_problems(problems: Problem, names: Sequence[ProblemName]) -> list[Problem]:
    """Return the problems of a batch, each with its name.

    Args:
        problems: [world] leading on all arrays, on the host or a device.
        names: of the first problems; others are left out.
    """
    leaves, structure = jax.tree.flatten(jax.tree.map(np.asarray, problems))
    named_problems = []
    for i, name in enumerate(names):
        problem: Problem = jax.tree.unflatten(structure, [leaf[i] for leaf in leaves])
        named_problems.append(replace(problem, name=name))
    return named_problems


@dataclass(frozen=True, kw_only=True)
class SampledBatch:
    """A device batch of sampled worlds, which may still be planned."""

    worlds: World
    tickets: Mapping[int, int] = field(default_factory=dict)
    """Tickets of its problems on the host, by the world's index in the device batch."""


def path_shape(
    spec: PlannerSpec | None, points: int, joint_names: tuple[str, ...] = ()
) -> PathShape:
    """Return the shape of a planner's paths.

    Args:
        spec: the planner; None without one.
        points: of the scenario.
        joint_names: of the joints of the fleet's arms.

    Raises:
        ConfigError: the planner plans the joints of arms, and no vehicle has any.
    """
    if spec is None:
        return PathShape(points=points)
    is_with_arm = register.plans_arms(spec)
    if is_with_arm and not joint_names:
        raise ConfigError(
            f"planner {spec.reference.name}: arm = true, and no vehicle of the fleet has joints; "
            "leave arm out, or fly a vehicle with links, such as bluerov2_heavy_alpha5"
        )
    return PathShape(
        points=points,
        joints=register.plans_joints(spec),
        arm=joint_names if is_with_arm else (),
    )


def start_planners(
    spec: PlannerSpec | None, shape: PathShape, count: int | None
) -> "HostPlanners | None":
    """Return the workers of a planner on the host; None without one, or for one on the device.

    Raises:
        ConfigError: the class is not a planner.
        UnsupportedError: a library of the planner is not installed.
    """
    if spec is None or spec.reference.on_device:
        return None
    if not callable(getattr(spec.reference.load(), "plan", None)):
        raise ConfigError(
            f"planner {spec.reference.name}: has neither plan(problem) nor plan_batch(problems)"
        )
    return HostPlanners(spec, shape.points, count)


class HostPlanners:
    """Worker processes of one planner, started at the first problem."""

    def __init__(self, spec: PlannerSpec, points: int, count: int | None) -> None:
        """Keep the planner; nothing is started yet.

        Args:
            spec: the planner.
            points: limit of way-points of a path.
            count: processes; one for each processor if left out.
        """
        self._spec = replace(spec, max_points=points)
        self._count = count or os.cpu_count() or 1
        self._workers: Workers | None = None

    def begin(self, problems: Mapping[int, Problem]) -> dict[int, int]:
        """Submit problems, by their indices, and return their tickets."""
        if self._workers is None:
            from angler_mjx.planning.host.workers import Workers

            self._workers = Workers(self._spec, self._count)
        return {at: self._workers.submit(problem) for at, problem in problems.items()}

    def finish(self, tickets: Mapping[int, int]) -> dict[int, Answer]:
        """Wait for answers and return them by their indices."""
        if self._workers is None:
            return {}
        return {at: self._workers.take(ticket) for at, ticket in tickets.items()}

    def close(self) -> None:
        """End all processes."""
        if self._workers is not None:
            self._workers.close()
            self._workers = None


def planning_status(has_path: np.ndarray, reported: np.ndarray | None = None) -> np.ndarray:
    """Return the planning status of worlds.

    Args:
        has_path: bool [w, r] robots with a path that is flown.
        reported: [w] text: reported statuses; those that count robots are computed again.

    Returns:
        [w] text: a status of `angler_mjx.planning.answers`.
    """
    incomplete = np.where(has_path.any(axis=1), "partial", "none")
    counted = np.where(has_path.all(axis=1), "planned", incomplete).astype(object)
    if reported is None:
        return counted
    is_ended = ~np.isin(reported.astype(str), ("", "planned", "partial", "none"))
    return np.where(is_ended, reported, counted).astype(object)


def gather_paths(answers: Mapping[int, Answer], initial: Path) -> tuple[Path, PlanNotes]:
    """Return answers as paths of a batch of worlds.

    Args:
        answers: by the indices of the worlds; robots of other worlds hold.
        initial: paths of robots that have none, [w, r] leading; their type and number of points are
            those of all.

    Returns:
        Paths, [w, r] leading, and their planning notes.
    """
    has_path = np.zeros(initial.time_s.shape[:2], bool)
    reason = np.full(has_path.shape, "", object)
    result = replace(jax.tree.map(np.array, initial), found=has_path)
    seconds, statuses = np.full(len(has_path), np.nan), np.full(len(has_path), "", object)
    for w, answer in answers.items():
        seconds[w], statuses[w] = answer.planning_s, answer.status
        for r, path in enumerate(answer.paths):
            if isinstance(path, NoPlan):
                reason[w, r] = path.reason
            elif type(path) is not type(initial):
                is_wanted_joint = isinstance(initial, JointTrajectory)
                reason[w, r] = (
                    f"returns {type(path).__name__}, but its class has joints = {is_wanted_joint}"
                )
            elif getattr(path, "joints", ()) != getattr(initial, "joints", ()):
                reason[w, r] = "moves other joints than its class says (arm)"
            else:
                _fill_path(result, (w, r), path)
                has_path[w, r] = True
    notes = PlanNotes(planning_s=seconds, status=planning_status(has_path, statuses), reason=reason)
    return result, notes


def warn_of_failures(notes: PlanNotes | None, first: int) -> None:
    """Warn of worlds whose planner failed, for callers that receive the worlds alone.

    Args:
        notes: notes of the worlds; None where they were planned on the device.
        first: index of the first world.
    """
    if notes is None:
        return
    failed = np.flatnonzero(np.isin(notes.status.astype(str), FAILED_STATUSES))
    if failed.size:
        count_text = f" ({failed.size} of {len(notes.status)} worlds)" if failed.size > 1 else ""
        reason = notes.reason[failed[0]][0]
        warnings.warn(
            f"world {first + failed[0]} has no plan: {reason}{count_text}",
            RuntimeWarning,
            stacklevel=4,
        )


def _fill_path(arrays: Path, index: tuple[int, int], path: Path) -> None:
    """Write a path into the arrays of all paths; its last row is repeated."""
    n = path.time_s.shape[0]
    for path_field in fields(arrays):
        rows, values = getattr(arrays, path_field.name), getattr(path, path_field.name)
        if path_field.name in ("joints", "found"):
            continue
        if path_field.name == "commanded":
            rows[index] = values
            continue
        rows[index][:n], rows[index][n:] = values, values[-1]
