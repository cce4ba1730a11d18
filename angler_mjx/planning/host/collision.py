"""A team among what it can touch, by Pinocchio and coal: the reference for what is compiled.

A configuration q has for each robot x, y, z, heading, then its arm's joints, if it has an arm (see
`robots`). Roll and pitch are 0.
"""

from collections.abc import Sequence
from typing import Any, NamedTuple, Self

import coal
import numpy as np
import pinocchio as pin

from angler_mjx.errors import ConfigError
from angler_mjx.planning.host import scenery
from angler_mjx.planning.host.robots import PlannedRobot, build, owner, team
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
    """A team and what it can touch: cells, sides of the cube, obstacles, and each other.

    Attributes:
        model: of Pinocchio; `q` of a team without arms is [4 R].
        geometry: its bodies; the robots' own first.
    """

    model: Any
    geometry: Any

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
        self._rock = scenery.enclosed(np.asarray(problem.grid.occupied))
        self.model, self.geometry, self._joints = build(robots)
        owners = np.array([owner(item.name) for item in self.geometry.geometryObjects])
        self._count = len(owners)
        self._moved = self._surround()
        items = list(self.geometry.geometryObjects)
        others = np.not_equal.outer(owners, owners)
        self._meets = np.ones((self._count, len(items)), bool)
        self._meets[:, : self._count] = others & np.triu(others)
        pairs = np.zeros((len(items), len(items)), bool)
        pairs[: self._count] = self._meets
        self.geometry.setCollisionPairs(pairs | pairs.T)
        self._data, self._shown = self.model.createData(), pin.GeometryData(self.geometry)
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
        self._place(pin.neutral(self.model))
        self._reach = np.zeros(len(robots))
        along = np.linalg.norm(self._centre[: self._count, :2], axis=1)
        np.maximum.at(self._reach, owners, along + self._radius[: self._count])
        self.at(0.0)

    @classmethod
    def from_problem(cls, problem: Problem) -> Self:
        """The team of a problem, in its world."""
        return cls(team(problem), problem)

    def q(self, place: np.ndarray) -> np.ndarray:
        """Configuration of a team, place [R, 4] of x, y, z, heading; arms at their neutral."""
        found = np.array(pin.neutral(self.model))
        for row, joint in zip(np.asarray(place, float), self._joints, strict=True):
            found[joint : joint + 4] = row
        return found

    def at(self, time_s: float) -> None:
        """Put the obstacles where they are known to be at a time."""
        items = self.geometry.geometryObjects
        for row, number in self._moved:
            items[number].placement = pin.SE3(*scenery.pose(self._problem, row, time_s))
        for number in range(self._count, len(items)):
            self._put(number, items[number].placement)
        self._world.update()

    def state(self, q: np.ndarray) -> bool:
        """Whether the team touches nothing at q."""
        self._place(q)
        if self._buried() is not None:
            return False
        for body in self._objects[: self._count]:
            hit = coal.CollisionCallBackDefault()
            self._world.collide(body, hit)
            if hit.data.result.isCollision():
                return False
        own = slice(0, self._count)
        apart = np.linalg.norm(self._centre[own, None] - self._centre[None, own], axis=-1)
        near = self._meets[:, own] & (apart <= np.add.outer(self._radius[own], self._radius[own]))
        return not any(
            coal.collide(
                self._objects[i], self._objects[j], coal.CollisionRequest(), coal.CollisionResult()
            )
            for i, j in np.argwhere(near)
        )

    def edge(self, a: np.ndarray, b: np.ndarray, resolution_m: float) -> bool:
        """Whether the team touches nothing at samples of the straight way from a to b.

        Args:
            a: configuration.
            b: configuration.
            resolution_m: no point of a hull moves farther from one sample to the next; an arm's own
                joints do not count.
        """
        way = 0.0
        for joint, reach in zip(self._joints, self._reach, strict=True):
            step = b[joint : joint + 4] - a[joint : joint + 4]
            way = max(way, float(np.linalg.norm(step[:3]) + reach * abs(step[3])))
        count = max(1, int(np.ceil(way / resolution_m)))
        return all(
            self.state(pin.interpolate(self.model, a, b, share))
            for share in np.linspace(0.0, 1.0, count + 1)
        )

    def clearance(self, q: np.ndarray) -> float:
        """Least distance of any robot to anything, m; see `NearestObstacle`."""
        return self.nearest(q).distance_m

    def nearest(self, q: np.ndarray) -> NearestObstacle:
        """What comes nearest to what at q.

        Pairs are worked out in the order of a lower bound of their distance, until that is no less
        than the least found.
        """
        self._place(q)
        buried = self._buried()
        if buried is not None:
            here = self._centre[buried].copy()
            return NearestObstacle(-np.inf, here, here, self._names[buried], "rock")
        bounds = self._bounds()
        best = NearestObstacle(np.inf, np.full(3, np.nan), np.full(3, np.nan), "", "")
        for flat in np.argsort(bounds, axis=None):
            i, j = divmod(int(flat), bounds.shape[1])
            if bounds[i, j] >= best.distance_m:
                break
            found = coal.DistanceResult()
            distance = coal.distance(self._objects[i], self._objects[j], _request(), found)
            if distance < best.distance_m:
                points = (np.array(found.getNearestPoint1()), np.array(found.getNearestPoint2()))
                best = NearestObstacle(distance, *points, self._names[i], self._names[j])
        return best

    def _surround(self) -> list[tuple[int, int]]:
        """Add what is no robot; rows of obstacles and their numbers among the bodies."""
        moved = []
        given = self._problem
        for part in (scenery.cells(given), scenery.walls(given), scenery.obstacles(given)):
            for body in part:
                placement = pin.SE3(body.rotation, body.centre_m)
                number = self.geometry.addGeometryObject(
                    pin.GeometryObject(body.name, 0, placement, body.shape)
                )
                if body.name.startswith("obstacle_"):
                    moved.append((int(body.name.split("_")[1]), int(number)))
        return moved

    def _place(self, q: np.ndarray) -> None:
        """Put the robots' bodies where q has them."""
        pin.updateGeometryPlacements(
            self.model, self._data, self.geometry, self._shown, np.asarray(q, float)
        )
        for number in range(self._count):
            self._put(number, self._shown.oMg[number])

    def _put(self, number: int, placement: Any) -> None:
        body = self._objects[number]
        self._turn[number], self._centre[number] = placement.rotation, placement.translation
        body.setTransform(coal.Transform3s(placement.rotation, placement.translation))
        body.computeAABB()

    def _buried(self) -> int | None:
        """A body whose origin lies in rock that has no geometry, if there is one.

        One that touches no rock that can be touched lies on one side of it with all its points.
        """
        grid = self._problem.grid
        places = self._centre[: self._count] - np.asarray(grid.origin_m, float)
        index = np.floor(places / float(grid.cell_m)).astype(int)
        found = np.flatnonzero(((index >= 0) & (index < self._rock.shape)).all(axis=1))
        hit = found[self._rock[tuple(index[found].T)]]
        return int(hit[0]) if len(hit) else None

    def _bounds(self) -> np.ndarray:
        """Lower bounds [robots' bodies, all bodies] of distances; -inf where two may overlap.

        The ball about a robot's body against the box of the other's own frame.
        """
        apart = self._centre[: self._count, None] - self._centre[None]
        local = np.abs(np.einsum("nji,mnj->mni", self._turn, apart))
        gap = np.linalg.norm(np.maximum(local - self._half, 0.0), axis=-1)
        bound = gap - self._radius[: self._count, None]
        return np.where(self._meets, np.where(bound > 0.0, bound, -np.inf), np.inf)


def _request() -> Any:
    """Distances with their points, signed, to 1e-5 m: coal stops at the square of a length."""
    wanted = coal.DistanceRequest(True, True)
    wanted.gjk_tolerance = 1e-10
    wanted.gjk_max_iterations = 1000
    return wanted
