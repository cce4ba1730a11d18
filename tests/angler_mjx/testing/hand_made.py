"""Run folders made by hand, for the referee: what a run stores, written without the simulator."""

import json
from dataclasses import dataclass, field, replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import zarr

DT_S = 0.05
OUTCOMES = {
    "running": 0,
    "reached": 1,
    "collision_static": 2,
    "collision_dynamic": 3,
    "collision_robot": 4,
    "out_of_bounds": 5,
    "timeout": 6,
    "diverged": 7,
    "failed": 8,
    "damaged": 9,
    "dropped": 10,
}
EDGE_M = 1.5
CELLS = (8, 8, 8)
LOW_M = (-6.0, -6.0, -12.0)
"""The region: 12 m wide, from 12 m depth to the surface."""
FLOOR_M = -12.5


@dataclass(frozen=True)
class Ball:
    """An obstacle that is a sphere; it moves if it has a velocity."""

    p_m: tuple
    r_m: float = 0.5
    v_mps: tuple = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Flight:
    """One world: T + 1 states, T commands, R robots."""

    p: np.ndarray
    """[T + 1, R, 3]."""
    nu: np.ndarray
    """[T + 1, R, 6]."""
    q: np.ndarray
    """[T + 1, R, 4]."""
    pwm: np.ndarray
    """[T, R, 8]."""
    outcome: np.ndarray
    """[T + 1, R]."""
    goal: np.ndarray
    """[R, 3]."""
    rows: list
    """A row of results for each robot."""
    rock: tuple = ()
    """Indices of occupied cells."""
    balls: tuple = ()
    obstacle_p: np.ndarray | None = None
    """[T + 1, O, 3]; from the balls' velocities if left out."""
    obstacle_q: np.ndarray | None = None
    """[T + 1, O, 4]; level if left out."""
    config: dict = field(default_factory=dict)
    """Further tables of the config."""
    fleet: tuple = field(default=({"vehicle": "bluerov2_heavy"},))
    """Entries of the config, one a robot; the last one for all that follow."""
    task: dict = field(default_factory=dict)
    """The table of the config; without a task there is none."""
    task_once: dict = field(default_factory=dict)
    """What is stored of the task once, by name."""
    task_over_time: dict = field(default_factory=dict)
    """And of each state, [T + 1, R]."""

    def positions(self):
        """[T + 1, O, 3] of the obstacles."""
        if self.obstacle_p is not None:
            return self.obstacle_p
        time = DT_S * np.arange(len(self.p))[:, None, None]
        p = np.array([ball.p_m for ball in self.balls]).reshape(-1, 3)
        v = np.array([ball.v_mps for ball in self.balls]).reshape(-1, 3)
        return p + time * v


def row(outcome, end_s, p, **more):
    """A row of results, with what is missing as runs store it."""
    reached = outcome == "reached"
    place = (np.nan,) * 3 if reached else p
    base = {
        "vehicle": "bluerov2_heavy",
        "parameter_set": "von_benzon2022",
        "outcome": outcome,
        "time_to_goal_s": end_s if reached else np.nan,
        "failure_time_s": np.nan if reached else end_s,
        **dict(zip(("failure_x_m", "failure_y_m", "failure_z_m"), place, strict=True)),
        "path_length_m": 0.0,
        "energy_j": 0.0,
        "min_clearance_m": 0.0,
        "min_separation_m": np.inf,
        "failure_pair": "none",
        "impact_speed_mps": np.nan,
    }
    return {**base, **more}


def straight(start, velocity, steps, end=None):
    """One robot on a straight line, level; held at rest from state ``end`` on. p, nu, q."""
    k = np.arange(steps + 1)
    moving = k if end is None else np.minimum(k, end)
    p = np.asarray(start) + DT_S * moving[:, None] * np.asarray(velocity)
    p = p.astype(np.float32)[:, None]
    nu = np.zeros((steps + 1, 1, 6), np.float32)
    nu[1:, 0, :3] = velocity
    if end is not None:
        nu[end + 1 :] = 0.0
    q = np.zeros((steps + 1, 1, 4), np.float32)
    q[..., 0] = 1.0
    return p, nu, q


def write(path, flight: Flight, *, every=1, with_end=True, whole_us=False, worlds=None):
    """Write a run folder with a world, or with as many copies of it as ``worlds`` says."""
    steps, robots = len(flight.pwm), flight.p.shape[1]
    fleet = [flight.fleet[min(i, len(flight.fleet) - 1)] for i in range(robots)]
    fleet = [{"count": 1, "battery_v": 16.0, **entry} for entry in fleet]
    count = worlds or 1
    timing = {
        "record_hz": 1.0 / (every * DT_S),
        "control_dt_s": DT_S,
        "horizon_s": steps * DT_S,
    }
    config = {"time": timing, "fleet": fleet, "goal_tolerance_m": 0.3, "worlds": count}
    if flight.task:
        config["task"] = flight.task
    config |= flight.config
    path.mkdir()
    (path / "config.json").write_text(json.dumps(config))
    (path / "summary.json").write_text(json.dumps({"worlds_done": count, "tile": 2}))
    rows = [
        {"world": w, "robot": i, **one} for w in range(count) for i, one in enumerate(flight.rows)
    ]
    pq.write_table(pa.Table.from_pylist(rows), path / "episodes.parquet")
    group = zarr.open_group(path / "trajectories.zarr", mode="w-")

    def put(name, values, dtype=np.float32):
        values = np.asarray(values, dtype)
        group.create_array(name, data=np.broadcast_to(values, (count, *values.shape)).copy())

    balls = flight.positions()
    turned = np.broadcast_to([1.0, 0.0, 0.0, 0.0], (*balls.shape[:2], 4))
    if flight.obstacle_q is not None:
        turned = flight.obstacle_q
    sampled = {"p_m": flight.p, "q": flight.q, "nu": flight.nu}
    if flight.balls:
        sampled |= {"obstacle_p_m": balls, "obstacle_q": turned}
    for name, values in sampled.items():
        put(name, values[:steps:every])
        if with_end:
            put(f"end/{name}", values[steps])
    put("outcome", flight.outcome[:steps:every], np.uint8)
    pwm = np.rint(flight.pwm) if whole_us else flight.pwm
    put("pwm_us", pwm[::every], np.uint16 if whole_us else np.float32)
    if with_end:
        put("end/outcome", flight.outcome[steps], np.uint8)
        put("end/step", steps, np.int32)
    for name, values in flight.task_once.items():
        put(f"task/{name}", values, np.asarray(values).dtype)
    for name, values in flight.task_over_time.items():
        put(f"task/{name}", values[:steps:every], np.int16)
    occupied = np.zeros(CELLS, bool)
    for cell in flight.rock:
        occupied[cell] = True
    still = [0 if ball.v_mps == (0.0, 0.0, 0.0) else 1 for ball in flight.balls]
    put("environment/grid/occupied", occupied, bool)
    put("environment/grid/origin_m", LOW_M)
    put("environment/grid/cell_m", EDGE_M)
    put("environment/floor_z_m", FLOOR_M)
    put("environment/start_m", flight.p[0])
    put("environment/start_yaw_rad", np.zeros(robots))
    put("environment/goal_m", flight.goal)
    put("environment/obstacles/kind", np.zeros(len(flight.balls)), np.int32)
    size = [(ball.r_m, 0.0, 0.0) for ball in flight.balls]
    put("environment/obstacles/size_m", np.array(size).reshape(-1, 3))
    put("environment/obstacles/motion", still, np.int32)
    put("environment/obstacles/exists", np.ones(len(flight.balls)), bool)
    return path


def edit_rows(path, world, robot, /, **values):
    """Change values of a row of results."""
    table = pq.read_table(path / "episodes.parquet")
    rows = table.to_pylist()
    for one in rows:
        if (one["world"], one["robot"]) == (world, robot):
            one.update(values)
    pq.write_table(pa.Table.from_pylist(rows, schema=table.schema), path / "episodes.parquet")


def edit_array(path, name, where, change):
    """Change a part of a stored array: ``change`` makes new values of the old ones."""
    array = zarr.open_group(path / "trajectories.zarr", mode="r+")[name]
    array[where] = change(array[where])


__all__ = ["Ball", "Flight", "edit_array", "edit_rows", "replace", "row", "straight", "write"]
