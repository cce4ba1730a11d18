"""Problems made by hand, and judges of motions that share nothing with what they judge."""

import coal
import numpy as np

from angler_mjx.planning.problem import Problem, Team
from angler_mjx.sim.information import CurrentInformation, Information, ObstacleInformation
from angler_mjx.world.rock.grid import Grid

HULL_A = np.array([[-0.15, 0.12, -0.02], [-0.15, -0.12, -0.02], [0.0, 0.0, 0.1]])
HULL_B = np.array([[0.15, 0.12, -0.02], [0.15, -0.12, -0.02], [0.0, 0.0, 0.1]])
HULL_R = np.array([0.1, 0.1, 0.08])
KINDS = {"sphere": 0, "box": 1, "capsule": 2}


def unit(rng, shape):
    v = rng.normal(size=shape)
    return v / np.linalg.norm(v, axis=-1, keepdims=True)


def sphere_of(a, b, r):
    return max(np.linalg.norm(a, axis=1).max(), np.linalg.norm(b, axis=1).max()) + r.max()


def body(kind, size, p, q=(1.0, 0.0, 0.0, 0.0), moves=False):
    """A row of `obstacles`; p [3], or [T, 3] of one that moves."""
    return KINDS[kind], size, np.atleast_2d(np.asarray(p, float)), np.asarray(q, float), moves


def obstacles(rows, time_s):
    n, t = len(rows), len(time_s)
    known = ObstacleInformation(
        kind=np.array([row[0] for row in rows], np.int32),
        half_size_m=np.array([row[1] for row in rows], float).reshape(n, 3),
        radius_m=np.zeros(n),
        exists=np.ones(n, bool),
        moves=np.array([row[4] for row in rows], bool),
        velocity_mps=np.zeros((n, 3)),
        time_s=np.asarray(time_s, float),
        p_m=np.array([np.broadcast_to(row[2], (t, 3)) for row in rows]).reshape(n, t, 3),
        q=np.array([np.broadcast_to(row[3], (t, 4)) for row in rows]).reshape(n, t, 4),
    )
    for i in range(n):
        x, y, z = known.half_size_m[i]
        known.radius_m[i] = (x, np.sqrt(x * x + y * y + z * z), x + y)[known.kind[i]]
    return known


def problem(
    occupied, *, cell_m=1.0, origin_m=(0.0, 0.0, 0.0), floor_z_m=-1e3, scale=(1.0,), bodies=(),
    time_s=(0.0,),
):  # fmt: skip
    """One world; robots are the hull above, ``scale`` times as large each."""
    size = np.array(scale)
    n = len(size)
    zeros = np.zeros((n, 3))
    return Problem(
        grid=Grid(
            occupied=np.asarray(occupied, bool),
            origin_m=np.array(origin_m),
            cell_m=np.float64(cell_m),
        ),
        floor_z_m=np.float64(floor_z_m),
        team=Team(
            start_m=zeros,
            start_yaw_rad=np.zeros(n),
            goal_m=zeros,
            radius_m=size * sphere_of(HULL_A, HULL_B, HULL_R),
            capsule_a_m=size[:, None, None] * HULL_A,
            capsule_b_m=size[:, None, None] * HULL_B,
            capsule_r_m=size[:, None] * HULL_R,
            cruise_speed_mps=np.ones(n),
            terminal_speed_mps=np.ones((n, 3)),
            power_w=np.ones((n, 3, 2)),
            acceleration_mps2=np.ones((n, 3)),
        ),
        obstacles=obstacles(list(bodies), time_s),
        current=CurrentInformation(components=(), stays=True),
        seed=np.uint32(0),
        horizon_s=120.0,
        goal_tolerance_m=0.5,
        information=Information(),
        deadline_s=5.0,
    )


def reef(seed, scale=(1.0, 0.8, 1.2), n=9, share=0.07, cell_m=1.3):
    """Random rock above a floor inside the cube, with a still obstacle of each kind."""
    rng = np.random.default_rng(seed)
    origin = np.array([-3.7, 2.1, -13.3])
    middle = rng.uniform(origin + cell_m, origin + cell_m * (n - 1), (3, 3))
    return problem(
        rng.random((n, n, n)) < share,
        cell_m=cell_m,
        origin_m=origin,
        floor_z_m=origin[2] + 0.4,
        scale=scale,
        bodies=[
            body("sphere", (0.6, 0.0, 0.0), middle[0]),
            body("box", (0.9, 0.3, 0.5), middle[1], unit(rng, 4)),
            body("capsule", (0.3, 0.8, 0.0), middle[2], unit(rng, 4)),
        ],
    )


def corners(world):
    low = np.array(world.grid.origin_m, float)
    return low, low + float(world.grid.cell_m) * np.array(world.grid.occupied.shape)


def places(world, rng, n):
    """[n, R, 3] anywhere in the cube."""
    return rng.uniform(*corners(world), (n, world.robots, 3))


def steps(rng, a, least, most):
    return a + unit(rng, a.shape) * rng.uniform(least, most, (*a.shape[:-1], 1))


class Judge:
    """Balls swept along lines, by coal: a capsule from where one starts to where it ends."""

    def __init__(self, world):
        grid, known = world.grid, world.obstacles
        edge, self.low = float(grid.cell_m), np.asarray(grid.origin_m, float).copy()
        self.high = corners(world)[1]
        self.radius = np.asarray(world.team.radius_m, float)
        cube = coal.Box(edge, edge, edge)
        self.kept = [
            coal.CollisionObject(cube, np.eye(3), self.low + edge * (index + 0.5))
            for index in np.argwhere(grid.occupied)
        ]
        self.low[2] = max(self.low[2], float(world.floor_z_m))
        for i in np.flatnonzero(known.exists & ~known.moves):
            x, y, z = (float(x) for x in known.half_size_m[i])
            shape = (coal.Sphere(x), coal.Box(2 * x, 2 * y, 2 * z), coal.Capsule(x, 2 * y))
            where = np.asarray(known.p_m[i, 0], float)
            turn = rotation(known.q[i, 0])
            self.kept.append(coal.CollisionObject(shape[known.kind[i]], turn, where))
        self.tree = coal.DynamicAABBTreeCollisionManager()
        for item in self.kept:
            self.tree.registerObject(item)
        self.tree.setup()

    def touches_world(self, robot, a, b, more=0.0):
        r = self.radius[robot] + more
        if (np.minimum(a, b) < self.low + r).any() or (np.maximum(a, b) > self.high - r).any():
            return True
        way = b - a
        length = np.linalg.norm(way)
        z = way / length if length > 0.0 else np.array([0.0, 0.0, 1.0])
        x = np.cross(z, np.eye(3)[np.argmin(np.abs(z))])
        x /= np.linalg.norm(x)
        turn = np.stack([x, np.cross(z, x), z], 1)
        ball = coal.CollisionObject(coal.Capsule(r, length), turn, 0.5 * (a + b))
        hit = coal.CollisionCallBackDefault()
        self.tree.collide(ball, hit)
        return hit.data.result.isCollision()

    def pairs_apart(self, a, b):
        """Least distance [n] between two spheres, by the vertex of the parabola of its square."""
        least = np.full(len(a), np.inf)
        for i in range(a.shape[1]):
            for j in range(i):
                w, v = a[:, i] - a[:, j], (b - a)[:, i] - (b - a)[:, j]
                square = np.sum(v * v, -1)
                s = -np.sum(w * v, -1) / np.where(square > 0.0, square, 1.0)
                apart = np.linalg.norm(w + np.clip(s, 0.0, 1.0)[:, None] * v, axis=-1)
                least = np.minimum(least, apart - self.radius[i] - self.radius[j])
        return least

    def touches(self, a, b, more=0.0):
        """bool [n]: whether edges a to b [n, R, 3] touch; distances less than ``more`` count."""
        world = [
            any(
                self.touches_world(i, p, q, more)
                for i, (p, q) in enumerate(zip(*rows, strict=True))
            )
            for rows in zip(a, b, strict=True)
        ]
        return np.array(world) | (self.pairs_apart(a, b) <= more)


def rotation(q):
    w, v = q[0] / np.linalg.norm(q), q[1:] / np.linalg.norm(q)
    cross = np.array([[0, -v[2], v[1]], [v[2], 0, -v[0]], [-v[1], v[0], 0]])
    return np.eye(3) + 2.0 * w * cross + 2.0 * cross @ cross
