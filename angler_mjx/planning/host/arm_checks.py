"""Compiled checks of teams with arms, made from the collision model of Pinocchio and coal."""

from collections.abc import Sequence
from functools import partial

import coal
import numpy as np
import pinocchio as pin

from angler_mjx.planning.host.compiled import arm_gaps
from angler_mjx.planning.host.compiled.packed import pack_problem
from angler_mjx.planning.host.robots import PlannedRobot, build_model, owner_index
from angler_mjx.planning.problem import Problem


class ArmChecker:
    """Checks states and paths of some robots of a problem, with their arms, among still bodies.

    It answers as `angler_mjx.planning.host.collision.TeamModel` does, up to rounding.
    """

    def __init__(
        self,
        robots: Sequence[PlannedRobot],
        problem: Problem,
        lever_m: np.ndarray,
        resolution_m: float,
    ) -> None:
        """Make a team ready.

        Args:
            robots: the team.
            problem: the world; its moving obstacles are ignored.
            lever_m: [R, d] how far a unit of each column of a configuration moves a point of the
                hull at most.
            resolution_m: no point of a hull moves farther from one checked state to the next.
        """
        model, geometry, columns = build_model(robots)
        packed = pack_problem(problem)
        kinds, joints = _describe_joints(model)
        body_joint, bodies, owners = _describe_bodies(geometry)
        first = np.searchsorted(owners, np.arange(len(robots) + 1)).astype(np.int64)
        base_rows = {int(kinds[k, 2]): k for k in range(len(kinds)) if _is_translation(kinds[k])}
        bases = np.array([base_rows[column] for column in columns], np.int64)
        self._shape = lever_m.shape
        self._is_path_free = partial(
            arm_gaps.is_path_free,
            *packed,
            kinds,
            joints,
            body_joint,
            bodies,
            first,
            bases,
            np.ascontiguousarray(lever_m, np.float64),
            float(resolution_m),
        )

    def state(self, q: np.ndarray) -> bool:
        """Return whether the team touches nothing at q [R, d]."""
        return self.path(np.reshape(q, (1, *self._shape)))

    def path(self, points: np.ndarray) -> bool:
        """Return whether the team touches nothing along straight edges between points [k, R, d].

        Raises:
            ValueError: the points have another shape.
        """
        if points.shape[1:] != self._shape:
            raise ValueError(f"points {points.shape}: must be [k, {self._shape}]")
        return bool(self._is_path_free(np.ascontiguousarray(points, np.float64)))


def _is_translation(kind: np.ndarray) -> bool:
    return int(kind[0]) == arm_gaps.TRANSLATION


def _describe_joints(model: pin.Model) -> tuple[np.ndarray, np.ndarray]:
    """Return kinds int64 [K, 3] and numbers [K, 15] of joints; see `arm_gaps`.

    Raises:
        TypeError: a joint is neither a translation, nor revolute, nor prismatic.
    """
    # Axes are read off the motion of each joint by one unit: classes of joints hide them.
    data, unit = model.createData(), np.ones(model.nq)
    pin.forwardKinematics(model, data, unit)
    kinds, numbers = [], []
    for number in range(1, model.njoints):
        joint, placement = model.joints[number], model.jointPlacements[number]
        moved = placement.inverse() * data.liMi[number]
        name, axis = joint.shortname(), np.zeros(3)
        if "Translation" in name:
            kind = arm_gaps.TRANSLATION
        elif "Prismatic" in name:
            kind, axis = arm_gaps.PRISMATIC, moved.translation
        elif joint.nq == 1:
            kind, axis = arm_gaps.REVOLUTE, pin.log3(moved.rotation)
        else:
            raise TypeError(f"joint {model.names[number]!r}: a {name} has no compiled checks")
        kinds.append([kind, int(model.parents[number]) - 1, int(joint.idx_q)])
        numbers.append([*placement.rotation.reshape(-1), *placement.translation, *axis])
    return np.array(kinds, np.int64), np.array(numbers, np.float64)


def _describe_bodies(geometry: pin.GeometryModel) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return joint int64 [B], capsule [B, 7] and robot [B] of bodies, robot by robot.

    Raises:
        TypeError: a body is neither a capsule nor a sphere.
    """
    rows = []
    for item in geometry.geometryObjects:
        shape, placement = item.geometry, item.placement
        if not isinstance(shape, coal.Capsule | coal.Sphere):
            raise TypeError(f"body {item.name!r}: only capsules and spheres are checked")
        half = shape.halfLength if isinstance(shape, coal.Capsule) else 0.0
        along = half * placement.rotation[:, 2]
        ends = (placement.translation - along, placement.translation + along)
        rows.append(
            (owner_index(item.name), item.parentJoint - 1, [*ends[0], *ends[1], shape.radius])
        )
    rows.sort(key=lambda row: row[0])
    owners, joints, capsules = zip(*rows, strict=True)
    return np.array(joints, np.int64), np.array(capsules, np.float64), np.array(owners)
