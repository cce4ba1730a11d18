"""A small run made by hand: what the pictures are drawn from, without simulating anything."""

import json
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from angler_mjx.report.plotting.scene import ReplayScene, RobotTrack
from angler_mjx.runs.storage.episode_columns import EPISODE_SCHEMA
from angler_mjx.runs.storage.folder import Run
from angler_mjx.runs.storage.recorder import Recorder, TrajectoryShape
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.world.currents import Uniform, Vortices
from angler_mjx.world.environment import Environment
from angler_mjx.world.obstacles import BOX, CAPSULE, DRIFT, SPHERE, STATIC, Obstacles
from angler_mjx.world.rock.grid import Grid

LEVEL = np.array([1.0, 0.0, 0.0, 0.0])


def make_environment(rng, shape=(16, 16, 16), cell=1.5, density=0.06, n_obstacle=12):
    n = n_obstacle
    occupied = np.zeros(shape, bool)
    for _ in range(int(density * np.prod(shape) / 9)):
        c = rng.integers(0, np.array(shape) - 3)
        occupied[c[0] : c[0] + 3, c[1] : c[1] + 2, c[2] : c[2] + 2] |= rng.random((3, 2, 2)) < 0.8
    size = cell * np.array(shape)
    origin = np.array([-size[0] / 2, -size[1] / 2, -size[2] - 2.0])
    kind = rng.choice([SPHERE, BOX, CAPSULE], n)
    radius = rng.uniform(0.4, 0.75, n)
    size_m = np.stack([radius, 0.6 * radius, 0.5 * radius], axis=1)
    size_m[kind == SPHERE, 1:] = 0
    size_m[kind == CAPSULE, 2] = 0
    q0 = rng.normal(size=(n, 4))
    corner = size / 2 - cell
    signs = np.array([[1, 1, 1], [-1, 1, -1], [1, -1, -1], [-1, -1, 1]])
    middle = origin + size / 2
    start = middle - signs * corner
    goal = middle + signs * corner
    zeros = np.zeros
    return Environment(
        grid=Grid(occupied=occupied, origin_m=origin, cell_m=np.float32(cell)),
        floor_z_m=np.float32(origin[2]),
        obstacles=Obstacles(
            kind=kind,
            size_m=size_m,
            motion=np.where(np.arange(n) % 4 == 0, STATIC, DRIFT),
            path=zeros((n, 8)),
            p0=origin + size * rng.random((n, 3)),
            q0=q0 / np.linalg.norm(q0, axis=1, keepdims=True),
            nu0=zeros((n, 6)),
            mass_kg=np.ones(n),
            inertia_kgm2=np.ones((n, 3)),
            volume_m3=np.ones(n),
            M_A=np.ones((n, 6)),
            D_l=np.ones((n, 6)),
            D_q=np.ones((n, 6)),
            exists=np.arange(n) != n - 1,
            kinds=(SPHERE, BOX, CAPSULE),
            motions=(STATIC, DRIFT),
        ),
        current=(
            Uniform(velocity_mps=jnp.array([0.1, 0.05, 0.0])),
            Vortices(
                centre_m=jnp.array([[3.0, -2.0], [-5.0, 6.0]]),
                circulation_m2ps=jnp.array([4.0, -3.0]),
                core_m=jnp.array([2.0, 1.5]),
            ),
        ),
        start_m=start,
        start_yaw_rad=zeros(4),
        goal_m=goal,
        density=np.float32(density),
        path_ratio=np.ones(4),
        line_free=np.ones(4, bool),
        redraws=np.int32(0),
        valid=np.bool_(True),
    )


ENDS = (
    ("reached", 55.0, "none"),
    ("collision_static", 20.0, "cell"),
    ("collision_dynamic", 31.0, "obstacle:3"),
    ("timeout", 60.0, "none"),
)


def make_scene(seed=0):
    rng = np.random.default_rng(seed)
    environment = make_environment(rng)
    time = np.arange(301) * 0.2
    tracks = []
    for i, (outcome, end, pair) in enumerate(ENDS):
        share = np.clip(np.minimum(time, end) / 58.0, 0, 1)[:, None]
        start, goal = environment.start_m[i], environment.goal_m[i]
        bend = np.sin(np.pi * share) * rng.normal(size=3) * 2
        p = start + share * (goal - start) + bend
        middle = 0.5 * (start + goal) + 2.2 * rng.normal(size=3)
        failed = outcome != "reached"
        tracks.append(
            RobotTrack(
                index=i,
                vehicle="bluerov2_heavy" if i < 2 else "bluerov2",
                vehicle_file="bluerov2_heavy" if i < 2 else "bluerov2",
                parameter_set="blue_gazebo",
                outcome=outcome,
                end_time_s=end,
                failure_pair=pair,
                failure_m=p[int(end / 0.2)] if failed else np.full(3, np.nan),
                p_m=p,
                q=np.tile(LEVEL, (time.size, 1)),
                current_mps=np.tile([0.1, 0.05, 0.0], (time.size, 1)),
                plan_m=np.stack([start, middle, goal]),
                start_m=start,
                goal_m=goal,
            )
        )
    given = environment.obstacles
    drift = np.where((given.motion == DRIFT)[:, None], [0.05, 0.03, 0.0], 0.0)
    return ReplayScene(
        world=12,
        time_s=time,
        environment=environment,
        robots=tuple(tracks),
        obstacle_p_m=given.p0 + time[:, None, None] * drift,
        obstacle_q=np.tile(given.q0, (time.size, 1, 1)),
    )


@pytest.fixture(scope="session")
def scene():
    return make_scene()


ROWS = 4
"""Padding of plans: the last way-point again."""


def make_run(path, scenes, worlds, motion=None):
    """Write a run folder that holds ``scenes`` as its worlds.

    ``motion`` holds what plans that are trajectories of joints have beside their way-points.
    """
    first = scenes[0]
    path.mkdir()
    config = load_scenario("reef_fleet", worlds=worlds).model_dump(mode="json")
    (path / "config.json").write_text(json.dumps(config))
    (path / "summary.json").write_text("{}")
    environment = jax.tree.map(
        lambda *leaves: np.stack(leaves), *(scene.environment for scene in scenes)
    )
    shape = TrajectoryShape(
        worlds=worlds,
        samples=first.time_s.size,
        robots=len(first.robots),
        thrusters=8,
        obstacles=first.obstacle_p_m.shape[1],
        plan_points=ROWS,
        jointed=motion is not None,
    )
    recorder = Recorder.create(
        path / "trajectories.zarr", shape, environment, tile=worlds, sample_dt_s=0.2
    )
    arrays = {**_arrays(scenes), **(motion or {})}
    recorder.write(0, {name: partial(arrays.get, name) for name in arrays}, environment)
    pq.write_table(
        pa.concat_tables([_episodes(i, scene) for i, scene in enumerate(scenes)]),
        path / "episodes.parquet",
    )
    return Run(path)


def make_motion(worlds):
    """Headings and velocities at the way-points of four robots; cubics, lines where it waits."""
    rng = np.random.default_rng(4)
    velocity = rng.normal(size=(worlds, 4, ROWS, 4)).astype(np.float32) * 0.3
    velocity[:, :, 2:] = 0.0
    degree = np.tile(np.uint8([3, 1, 1, 1]), (worlds, 4, 1))
    degree[:, 1] = 3
    return {
        "plan_yaw_rad": rng.normal(size=(worlds, 4, ROWS)).astype(np.float32),
        "plan_velocity": velocity,
        "plan_acceleration": np.zeros_like(velocity),
        "plan_degree": degree,
    }


@pytest.fixture(scope="session")
def jointed(tmp_path_factory):
    """The run with plans that have headings and velocities, and these."""
    motion = make_motion(2)
    path = tmp_path_factory.mktemp("runs") / "jointed"
    return make_run(path, [make_scene(0), make_scene(1)], 2, motion), motion


def _arrays(scenes):
    def stacked(name):
        rows = [[getattr(robot, name) for robot in scene.robots] for scene in scenes]
        return np.swapaxes(np.array(rows), 1, 2)

    plans = [[robot.plan_m for robot in scene.robots] for scene in scenes]
    padded = [[np.r_[plan, plan[-1:]] for plan in fleet] for fleet in plans]
    times = np.broadcast_to([0.0, 30.0, 60.0, 60.0], (len(scenes), len(plans[0]), ROWS))
    return {
        **{name: stacked(name) for name in ("p_m", "q", "current_mps")},
        "obstacle_p_m": np.array([scene.obstacle_p_m for scene in scenes]),
        "obstacle_q": np.array([scene.obstacle_q for scene in scenes]),
        "plan_m": np.array(padded),
        "plan_time_s": times,
    }


def _episodes(world, scene):
    rows = []
    for robot in scene.robots:
        arrived = robot.outcome == "reached"
        end = robot.end_time_s
        place = dict(zip("xyz", robot.failure_m.tolist(), strict=True))
        rows.append(
            {
                "world": world,
                "robot": robot.index,
                "seed": 7,
                "vehicle": robot.vehicle,
                "parameter_set": robot.parameter_set,
                "planned": True,
                "outcome": robot.outcome,
                "time_to_goal_s": end if arrived else None,
                "path_length_m": 30.0,
                "energy_j": 1000.0,
                "min_clearance_m": 0.4 if arrived else 0.0,
                "min_separation_m": 1.0,
                "failure_time_s": None if arrived else end,
                **{f"failure_{x}_m": None if arrived else value for x, value in place.items()},
                "failure_pair": robot.failure_pair,
                "impact_speed_mps": None,
                "redraws": 0,
            }
        )
    return pa.Table.from_pylist(rows, schema=EPISODE_SCHEMA)


@pytest.fixture(scope="session")
def run(tmp_path_factory):
    """A run folder of two worlds."""
    return make_run(tmp_path_factory.mktemp("runs") / "run", [make_scene(0), make_scene(1)], 2)


@pytest.fixture(scope="session")
def scene_maker():
    """Makes the scene of a seed again."""
    return make_scene
