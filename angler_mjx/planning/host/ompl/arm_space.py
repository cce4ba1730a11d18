"""Space of a team with arms: bases, headings and joints, checked by coal.

A configuration is [R, 4 + J]: x, y, z, heading, then the joints of the arm. Columns of joints that
nothing moves (grippers, and those of robots without links) keep their values and are no part of the
search. The search measures each column in metres: by how far it moves a point of the hull at most.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import Self

import numpy as np
import pinocchio as pin

from angler_mjx.host_arrays import as_leaf
from angler_mjx.planning.host.arm_checks import ArmChecker
from angler_mjx.planning.host.collision import TeamModel
from angler_mjx.planning.host.robots import TIP, PlannedRobot, build_model, team_arms
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.vehicles.link_params import LinkParams

BASE_WIDTH = 4
"""Columns of a base: x, y, z and heading."""

RESOLUTION_M = 0.04
"""No point of a hull moves farther from one checked state of an edge to the next."""

MIN_WEIGHT_M = 0.05
"""Least distance by which a radian of a joint counts."""

MAX_GOAL_SAMPLES = 4000
"""Sampled headings and postures at a goal."""


@dataclass(frozen=True, kw_only=True)
class ArmSpace:
    """Some robots of a problem, with their arms."""

    problem: Problem
    """Arrays of NumPy."""
    robots: Sequence[int]
    """Robots of the problem."""
    planned: Sequence[PlannedRobot]
    """Their bodies, each larger by the margin."""
    lever_m: np.ndarray
    """[R, 4 + J] how far a unit of each column moves a point of the hull at most."""
    checks: ArmChecker | None
    """Compiled checks; None among moving obstacles, which only the model puts where they are."""

    @classmethod
    def build(cls, problem: Problem, robots: Sequence[int], margin_m: float) -> Self:
        """Build the space of some robots.

        Args:
            problem: arrays of NumPy; its moving obstacles stand where they are at t = 0.
            robots: of its team.
            margin_m: by which hulls are larger.
        """
        planned, levers = [], []
        wide = _widen_links(problem, margin_m)
        for i, arm in enumerate(team_arms(wide)):
            if i in robots:
                planned.append(_planned_robot(wide, i, arm, margin_m))
                levers.append(_hull_levers(planned[-1]))
        lever_m, obstacles = np.array(levers), problem.obstacles
        moves = np.asarray(obstacles.exists, bool) & np.asarray(obstacles.moves, bool)
        checks = None if moves.any() else ArmChecker(planned, problem, lever_m, RESOLUTION_M)
        return cls(
            problem=problem,
            robots=robots,
            planned=planned,
            lever_m=lever_m,
            checks=checks,
        )

    @cached_property
    def model(self) -> TeamModel:
        """Return the collision model of coal."""
        return TeamModel(self.planned, self.problem)

    @cached_property
    def lower(self) -> np.ndarray:
        """Return the lower bounds [R, 4 + J]."""
        low = np.asarray(self.problem.lower_m, float).copy()
        low[2] = max(low[2], float(self.problem.floor_z_m))
        return self._bounds(low, -np.pi, np.asarray(self._links.lower, float))

    @cached_property
    def upper(self) -> np.ndarray:
        """Return the upper bounds [R, 4 + J]."""
        high = np.asarray(self.problem.upper_m, float)
        return self._bounds(high, np.pi, np.asarray(self._links.upper, float))

    @cached_property
    def start(self) -> np.ndarray:
        """Return the configuration [R, 4 + J] at the start."""
        team = self.problem.team
        assert team.arms is not None
        rows = (team.start_m, np.asarray(team.start_yaw_rad)[:, None], team.arms.joint_position)
        start = np.concatenate([np.asarray(values, float) for values in rows], axis=1)
        return np.asarray(start[list(self.robots)])

    @cached_property
    def moves(self) -> np.ndarray:
        """Return bool [R, 4 + J]: whether a column is searched."""
        links = self._links
        has_arm = np.asarray(links.mass_kg)[list(self.robots)].sum(axis=1) > 0.0
        joints = has_arm[:, None] & ~np.array(links.tree.grippers, bool)
        return np.concatenate([np.ones((len(joints), BASE_WIDTH), bool), joints], axis=1)

    @cached_property
    def weight_m(self) -> np.ndarray:
        """Return the weights [d] of the searched columns."""
        return np.asarray(np.maximum(self.lever_m, MIN_WEIGHT_M)[self.moves])

    def to_columns(self, q: np.ndarray) -> np.ndarray:
        """Return the searched columns [..., d], weighted, of configurations [..., R, 4 + J]."""
        columns: np.ndarray = self.weight_m * q[..., self.moves]
        return columns

    def from_columns(self, columns: np.ndarray) -> np.ndarray:
        """Return the configurations [..., R, 4 + J] of searched columns [..., d]."""
        q = np.broadcast_to(self.start, (*columns.shape[:-1], *self.start.shape)).copy()
        q[..., self.moves] = columns / self.weight_m
        return q

    def state(self, q: np.ndarray) -> bool:
        """Return whether the team touches nothing at q [R, 4 + J]."""
        if self.checks is not None:
            return self.checks.state(q)
        return self.model.state(np.asarray(q, float).reshape(-1))

    def edge(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Return whether the team touches nothing on the line from a to b, both [R, 4 + J]."""
        return self.path(np.stack([a, b]))

    def path(self, points: np.ndarray) -> bool:
        """Return whether the team touches nothing on the lines between points [k, R, 4 + J]."""
        if self.checks is not None:
            return self.checks.path(points)
        return all(self._edge_by_model(a, b) for a, b in pairwise(points))

    def _edge_by_model(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Return `edge` by the model of coal.

        States are checked in an order that halves the gaps, so that hits are found early.
        """
        moved_m = float((np.abs(b - a) * self.lever_m)[:, BASE_WIDTH - 1 :].sum(axis=1).max())
        moved_m += float(np.linalg.norm((b - a)[:, :3], axis=1).max())
        count = max(1, int(np.ceil(moved_m / RESOLUTION_M)))
        return all(self.state(a + (b - a) * (k / count)) for k in _halving_order(count))

    def clearance(self, q: np.ndarray) -> float:
        """Return the least distance of the team at q [R, 4 + J] to anything, m."""
        return self.model.clearance(np.asarray(q, float).reshape(-1))

    def sample_goals(self, random: np.random.Generator, count: int) -> np.ndarray:
        """Return free configurations [n, 4 + J] of the only robot at its goal, at most ``count``.

        Headings and postures are uniform within their limits. The base is where that brings the
        end effector to the goal, or else at the goal; the first of these have the start's heading
        and posture.
        """
        goal_m = np.asarray(self.problem.team.goal_m, float)[self.robots[0]]
        found: list[np.ndarray] = []
        for attempt in range(MAX_GOAL_SAMPLES):
            q = self.start.copy()
            if attempt:
                free = self.moves & (np.arange(q.shape[1]) >= BASE_WIDTH - 1)
                q[free] = random.uniform(self.lower[free], self.upper[free])
            q[0, :3] = goal_m - self._tip_m(q[0])
            if np.all((q >= self.lower) & (q <= self.upper)) and self.state(q):
                found.append(q[0])
            if len(found) == count:
                break
        return np.array(found).reshape(len(found), self.start.shape[1])

    def _tip_m(self, q: np.ndarray) -> np.ndarray:
        """Return where the point [3] m that has to come to the goal is from the base, along W."""
        if not self.problem.by_end_effector:
            return np.zeros(3)
        model, data = self._kinematics
        at = q.copy()
        at[:3] = 0.0
        pin.framesForwardKinematics(model, data, at)
        return np.array(data.oMf[model.getFrameId(f"robot_0_{TIP}")].translation)

    @cached_property
    def _kinematics(self) -> tuple[pin.Model, pin.Data]:
        model, _, _ = build_model(self.planned)
        return model, model.createData()

    @property
    def _links(self) -> LinkParams:
        arms = self.problem.team.arms
        assert arms is not None
        return arms.links

    def _bounds(self, corner_m: np.ndarray, turn_rad: float, joints: np.ndarray) -> np.ndarray:
        rows = list(self.robots)
        yaw = np.asarray(self.problem.team.start_yaw_rad, float)[rows, None] + turn_rad
        corner = np.broadcast_to(corner_m, (len(rows), 3))
        return np.concatenate([corner, yaw, joints[rows]], axis=1)


def _widen_links(problem: Problem, margin_m: float) -> Problem:
    """Return the problem with larger capsules of links."""
    arms = problem.team.arms
    assert arms is not None
    wide_m = as_leaf(np.asarray(arms.capsules.r_m) + margin_m)
    capsules = replace(arms.capsules, r_m=wide_m)
    return replace(problem, team=replace(problem.team, arms=replace(arms, capsules=capsules)))


def _planned_robot(
    problem: Problem, robot: int, arm: tuple[pin.Model, pin.GeometryModel], margin_m: float
) -> PlannedRobot:
    """Return a robot with a hull of its own and an arm; those of problems have both in one."""
    team = problem.team
    assert team.arms is not None
    base_count = np.shape(team.capsule_r_m)[1] - np.shape(team.arms.capsules.r_m)[1]
    a, b, r = (
        np.asarray(values, float)[robot, :base_count]
        for values in (team.capsule_a_m, team.capsule_b_m, team.capsule_r_m)
    )
    return PlannedRobot(capsule_a_m=a, capsule_b_m=b, capsule_r_m=r + margin_m, arm=arm)


def _hull_levers(robot: PlannedRobot) -> np.ndarray:
    """Return how far a unit of each column [4 + J] moves a point of a robot's hull at most."""
    assert robot.arm is not None
    model, geometry = robot.arm
    lever_m = np.zeros(model.nq)
    ends = np.concatenate([robot.capsule_a_m, robot.capsule_b_m])
    reach_m = float((np.linalg.norm(ends, axis=1) + np.tile(robot.capsule_r_m, 2)).max())
    for item in geometry.geometryObjects:
        item.geometry.computeLocalAABB()
        far = np.linalg.norm(item.geometry.aabb_center) + item.geometry.aabb_radius
        length_m = float(np.linalg.norm(item.placement.translation) + far)
        joint = item.parentJoint
        while joint:
            row = model.joints[joint].idx_q
            slides = "Prismatic" in model.joints[joint].shortname()
            lever_m[row] = max(lever_m[row], 1.0 if slides else length_m)
            limits = model.lowerPositionLimit[row], model.upperPositionLimit[row]
            length_m += max(map(abs, limits)) if slides else 0.0
            length_m += float(np.linalg.norm(model.jointPlacements[joint].translation))
            joint = model.parents[joint]
        reach_m = max(reach_m, length_m)
    return np.concatenate([np.ones(3), [reach_m], lever_m])


def _halving_order(count: int) -> list[int]:
    """Return 0 to count, ends first, then those in the middle of the gaps."""
    order, gaps = [0, count], [(0, count)]
    for low, high in gaps:
        if high - low > 1:
            middle = (low + high) // 2
            order.append(middle)
            gaps += [(low, middle), (middle, high)]
    return order
