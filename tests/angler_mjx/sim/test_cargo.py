"""Robots that carry a pipe: whole flights, the grasp along plans, shares, and what is refused."""

import copy
from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import plans
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.cargo import CargoError, finish_carrying
from angler_mjx.sim.physics.contact.grips import GripSpec, take_hold
from angler_mjx.sim.state import Outcome

G, WATER = 9.80665, 1000.0
RADIUS, LENGTH, MASS = 0.05, 2.0, 18.5
VOLUME = np.pi * RADIUS**2 * LENGTH + 4.0 / 3.0 * np.pi * RADIUS**3
START, GOAL, TURN = np.array([-1.0, -1.0, -6.0]), np.array([0.5, 0.5, -7.0]), np.pi / 3
TABLE = {
    "name": "carried",
    "engine": "mjx",
    "contacts": True,
    "worlds": 1,
    "tile": 1,
    "time": {"horizon_s": 40.0, "record_hz": 5.0, "physics_dt_s": 0.01},
    "task": {
        "type": "carry",
        "offset_m": [0.0, 0.0, 0.55],
        "to_m": GOAL.tolist(),
        "turn_deg": 60.0,
    },
    "world": {
        "preset": "open",
        "shape": [8, 8, 6],
        "obstacles": {
            "explicit": [
                {
                    "type": "capsule",
                    "radius_m": RADIUS,
                    "length_m": LENGTH,
                    "position_m": START.tolist(),
                    "rpy_deg": [0.0, 90.0, 0.0],
                    "mass_kg": MASS,
                    "motion": {"type": "drift"},
                }
            ]
        },
    },
    "fleet": [
        {
            "vehicle": "bluerov2_heavy",
            "parameter_set": "wu2018",
            "count": 2,
            "cruise_speed_mps": 0.4,
        }
    ],
}


def edit(**keys):
    """Return the table with keys of the task, or of other tables by name (``world__key``)."""
    table = copy.deepcopy(TABLE)
    for key, value in keys.items():
        *path, last = key.split("__")
        at = table["task"] if not path else table
        for step in path:
            at = at[int(step) if step.isdigit() else step]
        at[int(last) if last.isdigit() else last] = value
    return table


class Flight:
    """A flight to its end; arrays [time, ...] of the time before it."""

    def __init__(self, table):
        simulator = Simulator(Scenario.model_validate(table))
        self.world = simulator.worlds()
        state, samples = simulator.reset(self.world), []
        for _ in range(simulator.segments):
            state, sample, _ = simulator.advance(self.world, state)
            samples.append(jax.tree.map(lambda x: np.asarray(x)[0], sample))
        whole = jax.tree.map(lambda *x: np.concatenate(x), *samples)
        running = np.all(whole.outcome == Outcome.RUNNING, axis=1)
        self.p, self.q, self.pipe_p, self.pipe_q = (
            x[running] for x in (whole.p, whole.q, whole.obstacle_p[:, 0], whole.obstacle_q[:, 0])
        )
        self.after_p = whole.obstacle_p[~running, 0]
        self.robots_after_p = whole.p[~running]
        self.floor_z_m = float(np.asarray(self.world.environment.floor_z_m).ravel()[0])
        self.tally = jax.tree.map(lambda x: np.asarray(x)[0], state.tally)
        self.grips = jax.tree.map(lambda x: np.asarray(x)[0], state.grips)


@pytest.fixture(scope="module")
def flight():
    return Flight(TABLE)


def test_the_pipe_arrives_and_all_who_hold_it_with_it(flight):
    assert flight.tally.outcome.tolist() == [Outcome.REACHED] * 2
    assert np.ptp(flight.tally.end_time_s) == 0.0
    end_m = np.linalg.norm(flight.pipe_p[-1] - GOAL)
    assert end_m < 0.15  # 0.2 s before its arrival within 0.1 m
    assert np.all(flight.tally.cargo_error.distance_m < 0.1)
    assert np.all(flight.tally.cargo_error.angle_rad < np.radians(5.0))
    wanted = Rotation.from_euler("z", TURN) * Rotation.from_euler("y", np.pi / 2)
    apart = (wanted.inv() * Rotation.from_quat(flight.pipe_q[-1], scalar_first=True)).magnitude()
    np.testing.assert_allclose(apart, flight.tally.cargo_error.angle_rad[0], atol=0.01)


def test_robots_keep_their_pose_at_the_pipe_to_a_millimetre(flight):
    turn = Rotation.from_quat(flight.pipe_q, scalar_first=True)
    for robot in range(2):
        at = turn.inv().apply(flight.p[:, robot] - flight.pipe_p)
        assert np.abs(at - at[0]).max() < 1e-3
        attitude = turn.inv() * Rotation.from_quat(flight.q[:, robot], scalar_first=True)
        assert (attitude * attitude[0].inv()).magnitude().max() < 2e-3


def test_grips_bear_the_weight_of_the_pipe(flight):
    """Greatest forces are near half the weight in water: it moves slowly."""
    weight_n = (MASS - WATER * VOLUME) * G
    assert weight_n > 10.0
    total_n = flight.tally.grip_force_n.sum()
    assert 0.98 * weight_n < total_n < 1.5 * weight_n
    assert np.all(flight.tally.internal_force_n < 0.3 * weight_n)


def test_a_weak_grip_breaks_and_the_pipe_sinks():
    flight = Flight(edit(break_force_n=3.0, time__horizon_s=8.0))
    assert flight.tally.outcome.tolist() == [Outcome.DROPPED] * 2
    assert np.all(flight.tally.end_time_s < 2.0)
    assert not flight.grips.held.any()
    drag = 0.5 * WATER * 1.17 * 2.0 * RADIUS * LENGTH  # as of a cylinder; its caps drag too
    speed = np.sqrt((MASS - WATER * VOLUME) * G / drag)
    sunk = -np.diff(flight.after_p[-10:, 2]) / 0.2
    assert np.all((0.8 * speed < sunk) & (sunk < 1.05 * speed))


@pytest.fixture(scope="module")
def released():
    return Flight(edit(release=True, hold_s=1.5))


def test_a_released_pipe_sinks_at_its_terminal_speed_and_rests_on_the_floor(flight, released):
    """Weight in water against the drag of a cylinder and its caps, broadside."""
    assert released.tally.outcome.tolist() == [Outcome.REACHED] * 2
    assert not released.grips.held.any()
    np.testing.assert_array_equal(released.grips.wrench, 0.0)
    assert flight.grips.held.all()
    assert np.all(flight.grips.wrench[:, 2] < -5.0)
    area = 1.17 * 2.0 * RADIUS * LENGTH + 0.47 * np.pi * RADIUS**2
    speed = np.sqrt((MASS - WATER * VOLUME) * G / (0.5 * WATER * area))
    height = released.after_p[:, 2] - released.floor_z_m
    sinking = (height[1:] > 0.5) & (released.after_p[1:, 2] < GOAL[2] - 1.5)
    assert np.sum(sinking) > 10
    np.testing.assert_allclose(-np.diff(released.after_p[:, 2])[sinking] / 0.2, speed, rtol=0.03)
    np.testing.assert_allclose(height[-10:], RADIUS, atol=2e-3)


def test_robots_that_have_released_their_cargo_stay_where_they_are(released):
    at_goal = released.world.environment.goal_m[0]
    assert np.linalg.norm(released.robots_after_p - at_goal, axis=2).max() < 0.3
    assert np.linalg.norm(released.robots_after_p[-25:] - at_goal, axis=2).max() < 0.05


def test_a_cargo_that_has_to_stay_at_its_goal_arrives_so_much_later(flight, released):
    later_s = released.tally.end_time_s - flight.tally.end_time_s
    np.testing.assert_allclose(later_s, 1.45, atol=1e-4)  # the first step there counts


def test_time_at_the_goal_counts_without_a_break():
    spec = Scenario.model_validate(edit(hold_s=0.2, release=True)).cargo_spec()
    grips = take_hold(
        GripSpec(body=0), *(jnp.zeros((n, m)) for n, m in [(2, 3), (2, 4), (1, 3), (1, 4)])
    )
    grips = replace(grips, held=jnp.array([True, False]))
    done = []
    for distance_m in [0.09, 0.09, 0.09, 0.11, 0.09, 0.09, 0.09, 0.09, 0.09]:
        error = CargoError(distance_m=jnp.full(2, distance_m), angle_rad=jnp.zeros(2))
        before = grips
        grips, finished = finish_carrying(spec, grips, error, 0.05)
        done.append(finished.tolist())
        assert grips.held.tolist() == (before.held & ~finished).tolist()
    assert done == [[False, False]] * 7 + [[True, False]] + [[False, False]]
    grips = replace(grips, held=jnp.array([True, True]))
    kept, finished = finish_carrying(replace(spec, release=False), grips, error, 0.05)
    assert finished.tolist() == kept.held.tolist() == [True, True]


def test_digests_of_files_without_release_stay():
    plain = Scenario.model_validate(TABLE)
    assert not {"hold_s", "release"} & plain.task.problem_table().keys()
    assert Scenario.model_validate(edit(release=False, hold_s=0.0)).digest() == plain.digest()
    others = {
        Scenario.model_validate(edit(**keys)).digest()
        for keys in [{"release": True}, {"hold_s": 1.0}]
    }
    assert len(others | {plain.digest()}) == 3


def plan(table):
    """Return the planned positions [time, robot, 3], headings [time, robot] and times."""
    simulator = Simulator(Scenario.model_validate(table))
    world = simulator.worlds()
    path = jax.tree.map(lambda x: np.asarray(x)[0], world.path)
    time = np.linspace(0.0, path.time_s[0, -1], 400)
    states = [plans.joints_at(plans.of_robot(path, r), time) for r in range(path.time_s.shape[0])]
    position = np.stack([np.asarray(state.position) for state in states], axis=1)
    return position[..., :3], position[..., 3], time, path


def test_plans_stay_on_the_grasp():
    position, heading, time, path = plan(TABLE)
    assert path.found.all()
    offsets = np.array([[-1.0, 0.0, 0.55], [1.0, 0.0, 0.55]])
    middle = position.mean(axis=1)
    turn = heading - heading[0]
    np.testing.assert_allclose(turn[:, 0], turn[:, 1], atol=1e-6)
    np.testing.assert_allclose(turn[-1], TURN, rtol=1e-5)
    for robot in range(2):
        rotated = Rotation.from_euler("z", turn[:, robot, None]).apply(offsets[robot])
        wanted = middle + rotated - [0.0, 0.0, 0.55]
        assert np.abs(position[:, robot] - wanted).max() < 2e-3
    np.testing.assert_allclose(position[0], START + offsets, atol=1e-5)
    end = Rotation.from_euler("z", TURN).apply(offsets)
    np.testing.assert_allclose(position[-1], GOAL + end, atol=1e-5)
    speed = np.linalg.norm(np.diff(position, axis=0), axis=2) / np.diff(time)[:, None]
    assert 0.3 < speed.max() <= 0.4 * 1.01


def test_the_pipe_is_planned_around_rock_and_not_through_a_narrow_gap():
    wall = {"type": "box", "position_m": [0.0, 0.0, -6.0], "size_m": [12.0, 0.5, 9.0]}
    bodies = [*TABLE["world"]["obstacles"]["explicit"], wall]
    start = {**bodies[0], "position_m": [-1.0, -2.5, -6.0]}
    table = edit(world__obstacles__explicit=[start, wall], to_m=[0.5, 2.5, -7.0])
    *_, path = plan(table)
    assert not path.found.any()
    wall["size_m"] = [3.0, 0.5, 9.0]  # free beside it: the ball of pipe and robots has 1.5 m
    wall["position_m"] = [-2.5, 0.0, -6.0]
    position, *_, path = plan(table)
    assert path.found.all()
    beside = np.abs(position[..., 1]) < 0.25
    assert np.all(position[..., 0][beside] > -1.0)


def test_a_share_is_what_the_robot_bears():
    """A pipe along x, robots that look along it: surge is along the pipe, sway and heave across."""
    along = Scenario.model_validate(edit(to_m=[1.0, -1.0, -6.0], turn_deg=0.0)).cargo_load()
    np.testing.assert_allclose([along.mass_kg, along.volume_m3], [MASS / 2, VOLUME / 2], rtol=1e-6)
    across = 1.17 * 2.0 * RADIUS * LENGTH / 2
    assert across < along.drag_area_m2[1] < 1.1 * across
    np.testing.assert_allclose(along.drag_area_m2[1], along.drag_area_m2[2], rtol=1e-5)
    assert along.drag_area_m2[0] < 0.1 * across
    lateral = Scenario.model_validate(edit(to_m=[-1.0, 1.0, -6.0], turn_deg=0.0)).cargo_load()
    np.testing.assert_allclose(
        np.array(lateral.added_mass_kg)[[1, 0, 2]], along.added_mass_kg, rtol=1e-5
    )


def test_robots_are_spread_along_the_longest_axis():
    scenario = Scenario.model_validate(edit(fleet__0__count=3))
    want = START + np.array([[-1.0, 0.0, 0.55], [0.0, 0.0, 0.55], [1.0, 0.0, 0.55]])
    np.testing.assert_allclose(scenario.world.start_m, want, atol=1e-9)
    again = Scenario.model_validate(scenario.model_dump(mode="json"))
    assert again.world.start_m == scenario.world.start_m
    assert again.digest() == scenario.digest()
    other = Scenario.model_validate(edit(break_force_n=100.0))
    assert other.digest() != Scenario.model_validate(TABLE).digest()


@pytest.mark.parametrize(
    ("keys", "text"),
    [
        ({"contacts_": False}, "set contacts = true"),
        ({"body": 1}, "task.body = 1: world.obstacles.explicit has 1 bodies"),
        ({"world__obstacles__explicit__0__motion": {"type": "static"}}, "nobody can carry it"),
        ({"grips_m": [[0, 0, 1]]}, "task.offset_m and task.grips_m"),
        ({"grips_m": [[0, 0, 1]], "offset_m_": None}, "1 positions and the fleet 2 robots"),
        ({"fleet__0__count": 17}, "17 robots; 16 are the most"),
        ({"world__placement": "cross"}, "says where robots start"),
        ({"world__obstacles__explicit__0__mass_kg": 80.0}, "its thrusters give"),
        ({"planner_": {"replan_hz": 1.0}}, "plans made before the flight"),
        ({"offset_m": [0.0, 0.0, 0.2]}, "the robot's radius"),
    ],
)
def test_what_cannot_be_carried_is_refused(keys, text):
    keys = dict(keys)
    top = {key[:-1]: keys.pop(key) for key in list(keys) if key in ("contacts_", "planner_")}
    no_offset = "offset_m_" in keys and not keys.pop("offset_m_")
    table = edit(**keys) | top
    if no_offset:
        del table["task"]["offset_m"]
    with pytest.raises((ConfigError, ValueError), match=text.replace("[", r"\[")):
        Simulator(Scenario.model_validate(table))
