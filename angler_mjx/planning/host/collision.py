"""Collision model of a team by Pinocchio and coal: the reference for the compiled checks.

A configuration q has for each robot x, y, z, heading, then its arm's joints, if it has an arm (see
`robots`). Roll and pitch are 0.
"""

from collections.abc import Sequence
from typing import NamedTuple, Self

import coal
import numpy as np
import pinocchio as pin

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host import scenery
from angler_mjx.planning.host.robots import (
    PlannedRobot,
    arm_reach_m,
    build_model,
    owner_index,
    team_hulls,
)
from angler_mjx.planning.problem import Problem


class NearestObstacle(NamedTuple):
    """The two bodies that come nearest to each other."""

    distance_m: float
    """Negative where they overlap; -inf where a body is all within rock."""
    point_a_m: np.ndarray
    """[3] W, on the first."""
    point_b_m: np.ndarray
    """[3] on the second."""
    name_a: str
    """``robot_N_capsule_M``, or ``robot_N_`` and a name of its arm's."""
    name_b: str
    """Another robot's, ``cell_I_J_K``, ``obstacle_N``, or a side of the cube."""


class TeamModel:
    """Collision model of a team: rock, sides of the cube, obstacles, and each other.

    Attributes:
        model: of Pinocchio; `q` of a team without arms is [4 R].
        geometry: its bodies; the robots' own first.
    """

    model: pin.Model
    geometry: pin.GeometryModel

    def __init__(self, robots: Sequence[PlannedRobot], problem: Problem) -> None:
        """Build the model.

        Args:
            robots: the team; it need not be the problem's.
            problem: the world; its obstacles stand where they are at t = 0 until `at` is called.

        Raises:
            ConfigError: there are no robots.
        """
        if not robots:
            raise ConfigError("a team has one robot at least")
        self._problem = problem
        self._rock = scenery.enclosed_rock(np.asarray(problem.grid.occupied))
        self.model, self.geometry, self._joints = build_model(robots)
        owners = np.array([owner_index(item.name) for item in self.geometry.geometryObjects])
        self._count = len(owners)
        self._moved = self._add_scenery()
        items = list(self.geometry.geometryObjects)
        others = np.not_equal.outer(owners, owners)
        self._meets = np.ones((self._count, len(items)), bool)
        self._meets[:, : self._count] = others & np.triu(others)
        pairs = np.zeros((len(items), len(items)), bool)
        pairs[: self._count] = self._meets
        self.geometry.setCollisionPairs(pairs | pairs.T)
        self._data, self._geometry_data = self.model.createData(), pin.GeometryData(self.geometry)
        for item in items:
            item.geometry.computeLocalAABB()
        self._names = [item.name for item in items]
        shapes = [item.geometry for item in items]
        off = np.array([np.linalg.norm(shape.aabb_center) for shape in shapes])
        self._radius = np.array([shape.aabb_radius for shape in shapes]) + off
        ends = np.array([(shape.aabb_local.min_, shape.aabb_local.max_) for shape in shapes])
        self._half = np.abs(ends).max(axis=1)
        self._objects = [coal.CollisionObject(shape) for shape in shapes]
        self._world = coal.DynamicAABBTreeCollisionManager()
        for body in self._objects[self._count :]:
            self._world.registerObject(body)
        self._turn, self._centre = np.zeros((len(items), 3, 3)), np.zeros((len(items), 3))
        self._update_placements(pin.neutral(self.model))
        self._reach = np.zeros(len(robots))
        along = np.linalg.norm(self._centre[: self._count, :2], axis=1)
        along = np.maximum(along, arm_reach_m(self.model, self.geometry, self._count))
        np.maximum.at(self._reach, owners, along + self._radius[: self._count])
        self.at(0.0)

    @classmethod
    def from_problem(cls, problem: Problem) -> Self:
        """Build the team of a problem in its world."""
        return cls(team_hulls(problem), problem)

    def q(self, pose: np.ndarray, postures: Sequence[Sequence[float]] | None = None) -> np.ndarray:
        """Return the configuration of a team.

        Args:
            pose: [R, 4] x, y, z, heading.
            postures: [R] joints of each robot's arm, none of a robot without one; arms at neutral
                if left out.
        """
        configuration = np.array(pin.neutral(self.model))
        arms = [()] * len(self._joints) if postures is None else postures
        for row, arm, joint in zip(np.asarray(pose, float), arms, self._joints, strict=True):
            configuration[joint : joint + 4 + len(arm)] = [*row, *arm]
        return configuration

    def at(self, time_s: float) -> None:
        """Put the obstacles where they are known to be at a time."""
        items = self.geometry.geometryObjects
        for row, number in self._moved:
            items[number].placement = pin.SE3(*scenery.obstacle_pose(self._problem, row, time_s))
        for number in range(self._count, len(items)):
            self._set_placement(number, items[number].placement)
        self._world.update()

    def state(self, q: np.ndarray) -> bool:
        """Return whether the team touches nothing at q."""
        self._update_placements(q)
        if self._find_buried() is not None:
            return False
        for body in self._objects[: self._count]:
            hit = coal.CollisionCallBackDefault()
            self._world.collide(body, hit)
            if hit.data.result.isCollision():
                return False
        robots = slice(0, self._count)
        distance_m = np.linalg.norm(
            self._centre[robots, None] - self._centre[None, robots], axis=-1
        )
        is_near = self._meets[:, robots] & (
            distance_m <= np.add.outer(self._radius[robots], self._radius[robots])
        )
        return not any(
            coal.collide(
                self._objects[i], self._objects[j], coal.CollisionRequest(), coal.CollisionResult()
            )
            for i, j in np.argwhere(is_near)
        )

    def edge(self, a: np.ndarray, b: np.ndarray, resolution_m: float) -> bool:
        """Return whether the team touches nothing at samples of the line from a to b.

        Args:
            a: configuration.
            b: configuration.
            resolution_m: no point of a hull moves farther from one sample to the next; an arm's own
                joints do not count.
        """
        length_m = 0.0
        for joint, reach in zip(self._joints, self._reach, strict=True):
            step = b[joint : joint + 4] - a[joint : joint + 4]
            length_m = max(length_m, float(np.linalg.norm(step[:3]) + reach * abs(step[3])))
        count = max(1, int(np.ceil(length_m / resolution_m)))
        return all(
            self.state(pin.interpolate(self.model, a, b, fraction))
            for fraction in np.linspace(0.0, 1.0, count + 1)
        )

    def clearance(self, q: np.ndarray) -> float:
        """Return the least distance of any robot to anything, m; see `NearestObstacle`."""
        return self.nearest(q).distance_m

    def nearest(self, q: np.ndarray) -> NearestObstacle:
        """Return the nearest pair of bodies at q.

        Pairs are computed in the order of a lower bound of their distance, until that is no less
        than the least found.
        """
        self._update_placements(q)
        buried = self._find_buried()
        if buried is not None:
            point_m = self._centre[buried].copy()
            return NearestObstacle(-np.inf, point_m, point_m, self._names[buried], "rock")
        bounds = self._distance_bounds()
        best = NearestObstacle(np.inf, np.full(3, np.nan), np.full(3, np.nan), "", "")
        for flat in np.argsort(bounds, axis=None):
            i, j = divmod(int(flat), bounds.shape[1])
            if bounds[i, j] >= best.distance_m:
                break
            result = coal.DistanceResult()
            distance = coal.distance(
                self._objects[i], self._objects[j], _distance_request(), result
            )
            if distance < best.distance_m:
                points = (np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2()))
                best = NearestObstacle(distance, *points, self._names[i], self._names[j])
        return best

    def _add_scenery(self) -> list[tuple[int, int]]:
        """Add all bodies but robots; return rows of obstacles and their numbers among bodies."""
        moving = []
        problem = self._problem
        for bodies in (
            scenery.rock_bodies(problem),
            scenery.wall_bodies(problem),
            scenery.obstacle_bodies(problem),
        ):
            for body in bodies:
                placement = pin.SE3(body.rotation, body.centre_m)
                number = self.geometry.addGeometryObject(
                    pin.GeometryObject(body.name, 0, placement, body.shape)
                )
                if body.name.startswith("obstacle_"):
                    moving.append((int(body.name.split("_")[1]), int(number)))
        return moving

    def _update_placements(self, q: np.ndarray) -> None:
        """Put the robots' bodies where q has them."""
        pin.updateGeometryPlacements(
            self.model, self._data, self.geometry, self._geometry_data, np.asarray(q, float)
        )
        for number in range(self._count):
            self._set_placement(number, self._geometry_data.oMg[number])

    def _set_placement(self, number: int, placement: pin.SE3) -> None:
        body = self._objects[number]
        self._turn[number], self._centre[number] = placement.rotation, placement.translation
        body.setTransform(coal.Transform3s(placement.rotation, placement.translation))
        body.computeAABB()

    def _find_buried(self) -> int | None:
        """Return a body whose origin lies in rock without geometry; None if there is none.

        One that touches no rock that can be touched lies on one side of it with all its points.
        """
        grid = self._problem.grid
        positions_m = self._centre[: self._count] - np.asarray(grid.origin_m, float)
        index = np.floor(positions_m / float(grid.cell_m)).astype(int)
        inside = np.flatnonzero(((index >= 0) & (index < self._rock.shape)).all(axis=1))
        hit = inside[self._rock[tuple(index[inside].T)]]
        return int(hit[0]) if len(hit) else None

    def _distance_bounds(self) -> np.ndarray:
        """Return lower bounds [robots' bodies, all bodies] of distances; -inf on possible overlap.

        The ball about a robot's body against the box of the other's own frame.
        """
        apart = self._centre[: self._count, None] - self._centre[None]
        local = np.abs(np.einsum("nji,mnj->mni", self._turn, apart))
        gap = np.linalg.norm(np.maximum(local - self._half, 0.0), axis=-1)
        bound = gap - self._radius[: self._count, None]
        return np.where(self._meets, np.where(bound > 0.0, bound, -np.inf), np.inf)


def _distance_request() -> coal.DistanceRequest:
    """Return a request for signed distances with points, to 1e-5 m: coal stops at its square."""
    request = coal.DistanceRequest(True, True)
    request.gjk_tolerance = 1e-10
    request.gjk_max_iterations = 1000
    return request
