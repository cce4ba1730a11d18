"""Whole worlds with contact: free flight, pushing, landing, rock, impacts, and a sinking pipe."""

from dataclasses import dataclass, replace
from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.episode_columns import EPISODE_COLUMNS, TileResult
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.state import Outcome, Touched

FREE, PUSHES, LANDS, PRESSES, RAMS = range(5)
"""Robots of the world."""
BOX, PIPE, LONG_PIPE = range(3)
START = [[-8, -8, -10], [-6, 0, -10], [4, 6, -25.4], [-5.4, 6, -10], [-6.5, -4, -10]]
GOAL = [[9, -8, -10], [4, 0, -10], [9, 9, -10], [9, 6, -10], [9, -4, -10]]
END = [*GOAL[:2], [4, 6, -25.98], *GOAL[3:]]
"""Ends of the paths: one robot flies into the floor, and its goal is elsewhere."""
SPEED_MPS = [0.5, 0.5, 0.2, 0.3, 1.2]
ROCK = [[-4.0, 6.0, -10.0], [-4.0, -4.0, -10.0]]
"""Points in the cells of rock that the last two robots meet."""
BEAMS = [[-6.75, -6.75, -25.25], [-3.75, -6.75, -25.25]]
"""Points in the cells of rock on which a pipe of 4.2 m lands, its middle between them."""
RADIUS, LENGTH, DENSITY = 0.1, 1.0, 1200.0
VOLUME = np.pi * RADIUS**2 * LENGTH + 4.0 / 3.0 * np.pi * RADIUS**3
FLOOR_M = -26.0
PHYSICS_S = 0.01
WORLD = {
    "name": "contact",
    "engine": "mjx",
    "worlds": 1,
    "tile": 1,
    "time": {"horizon_s": 8.0, "record_hz": 10.0, "physics_dt_s": PHYSICS_S},
    "world": {
        "preset": "open",
        "placement": "given",
        "start_m": START,
        "goal_m": GOAL,
        "obstacles": {
            "explicit": [
                {
                    "type": "box",
                    "size_m": [0.4, 0.4, 0.4],
                    "position_m": [-5.2, 0.0, -10.0],
                    "motion": {"type": "drift"},
                },
                {
                    "type": "capsule",
                    "radius_m": RADIUS,
                    "length_m": LENGTH,
                    "position_m": [8.0, 8.0, -23.5],
                    "rpy_deg": [0.0, 90.0, 0.0],
                    "mass_kg": VOLUME * DENSITY,
                    "motion": {"type": "drift"},
                },
            ]
        },
    },
    "fleet": [{"vehicle": "bluerov2_heavy", "parameter_set": "wu2018", "count": 5}],
}


LONG = {
    "type": "capsule",
    "radius_m": RADIUS,
    "length_m": 4.0,
    "position_m": [-5.7, -6.75, -23.5],
    "rpy_deg": [0.0, 90.0, 0.0],
    "mass_kg": (np.pi * RADIUS**2 * 4.0 + 4.0 / 3.0 * np.pi * RADIUS**3) * DENSITY,
    "motion": {"type": "drift"},
}


@dataclass(frozen=True)
class Flight:
    """What a flight left."""

    p: Any
    """[time, robot, 3]."""
    obstacle_p: Any
    """[time, obstacle, 3]."""
    end: Any
    world: Any


def fly(table):
    """Fly straight lines from start to goal, through all that is there."""
    simulator = Simulator(Scenario.model_validate(table))
    world = simulator.worlds()
    grid = world.environment.grid
    occupied = np.array(grid.occupied)
    origin, cell = np.asarray(grid.origin_m)[0], float(np.asarray(grid.cell_m)[0])
    for point in ROCK + BEAMS:
        occupied[(0, *np.floor((np.array(point) - origin) / cell).astype(int))] = True
    ends = np.stack([START, END], axis=1).astype(np.float32)
    seconds = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1) / SPEED_MPS
    points = world.path.time_s.shape[2]
    time = np.concatenate([np.zeros((5, 1)), np.repeat(seconds[:, None], points - 1, 1)], axis=1)
    line = np.concatenate([ends[:, :1], np.repeat(ends[:, 1:], points - 1, axis=1)], axis=1)
    path = Trajectory(
        time_s=jnp.asarray(time, jnp.float32)[None],
        position_m=jnp.asarray(line)[None],
        found=jnp.ones((1, 5), bool),
    )
    environment = replace(
        world.environment, grid=replace(grid, occupied=jnp.asarray(occupied, grid.occupied.dtype))
    )
    world = replace(world, environment=environment, path=path)
    state = simulator.reset(world)
    p, obstacles = [], []
    for _ in range(simulator.segments):
        state, sample, _ = simulator.advance(world, state)
        p.append(np.asarray(sample.p)[0])
        obstacles.append(np.asarray(sample.obstacle_p)[0])
    return Flight(np.concatenate(p), np.concatenate(obstacles), state, world)


@pytest.fixture(scope="module")
def touching():
    explicit = [*WORLD["world"]["obstacles"]["explicit"], LONG]
    world = WORLD["world"] | {"obstacles": {"explicit": explicit}}
    return fly(WORLD | {"contacts": True, "contact": {"damage_energy_j": 4.0}, "world": world})


@pytest.fixture(scope="module")
def alone():
    return fly(WORLD)


def test_a_robot_that_touches_nothing_flies_as_without_contact(touching, alone):
    np.testing.assert_array_equal(touching.p[:, FREE], alone.p[:, FREE])
    tally = touching.end.tally
    assert int(tally.touched[0, FREE]) == Touched.NOTHING
    assert float(tally.impact_energy_j[0, FREE]) == 0.0
    assert float(tally.contact_depth_m[0, FREE]) == 0.0
    assert np.isnan(float(tally.impact_speed_mps[0, FREE]))


def test_touches_are_no_collisions_and_a_hard_impact_is_damage(touching, alone):
    outcome = np.asarray(touching.end.tally.outcome)[0]
    assert outcome[RAMS] == Outcome.DAMAGED
    assert not np.isin(outcome[[FREE, PUSHES, LANDS, PRESSES]], [Outcome.DAMAGED]).any()
    collisions = [Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC, Outcome.COLLISION_ROBOT]
    assert not np.isin(outcome, collisions).any()
    without = np.asarray(alone.end.tally.outcome)[0]
    assert np.isin(without[[PUSHES, LANDS, PRESSES, RAMS]], collisions).all()
    energy = np.asarray(touching.end.tally.impact_energy_j)[0]
    assert energy[RAMS] > 4.0
    assert np.all(
        (energy[[PUSHES, LANDS, PRESSES]] > 0.0) & (energy[[PUSHES, LANDS, PRESSES]] < 4.0)
    )


def test_a_robot_pushes_a_box_along(touching):
    moved = touching.obstacle_p[-1, BOX] - touching.obstacle_p[0, BOX]
    assert moved[0] > 0.5
    assert touching.p[-1, PUSHES, 0] > -4.7 + moved[0] - 1.0
    # It stays behind the box: its centre never is beyond the box's near side.
    near = touching.obstacle_p[:, BOX, 0] - 0.2
    beside = np.abs(touching.obstacle_p[:, BOX, 1:] - touching.p[:, PUSHES, 1:])
    straight = np.all(beside < 0.15, axis=1)
    assert straight.sum() > 40
    assert np.all((touching.p[:, PUSHES, 0] < near)[straight])


def test_robots_land_and_press_without_going_through(touching):
    cell = float(np.asarray(touching.world.environment.grid.cell_m)[0])
    origin = np.asarray(touching.world.environment.grid.origin_m)[0]
    face = origin[0] + cell * np.floor((ROCK[0][0] - origin[0]) / cell)
    assert np.all(touching.p[:, PRESSES, 0] < face)
    assert touching.p[-1, PRESSES, 0] > face - 0.6
    assert np.all(touching.p[:, LANDS, 2] > FLOOR_M)
    assert touching.p[-1, LANDS, 2] < FLOOR_M + 0.5
    rest = touching.p[-20:, LANDS, 2]
    assert np.ptp(rest) < 5e-3  # it presses on with its thrusters
    depth = np.asarray(touching.end.tally.contact_depth_m)[0]
    assert np.all((depth[1:] > 0.0) & (depth[1:] < 0.03))


def test_columns_say_what_was_touched_and_how_hard(touching):
    tally = touching.end.tally
    result = TileResult(
        world=np.zeros(1, int),
        variant=np.zeros((1, 5), int),
        planned=np.ones((1, 5), bool),
        outcome=np.asarray(tally.outcome),
        tally=replace(tally, **{k: np.asarray(v) for k, v in vars(tally).items() if v is not None}),
        p=np.asarray(touching.end.vehicles.p),
    )
    columns = {column.name: column for column in EPISODE_COLUMNS}
    pairs = columns["failure_pair"].of_tile(result)[0]
    assert list(pairs) == ["none", f"obstacle:{BOX}", "floor", "cell", "cell"]
    energy = columns["impact_energy_j"].of_tile(result)[0]
    speed = columns["impact_speed_mps"].of_tile(result)[0]
    assert energy[FREE] == 0.0
    # Half the effective mass times speed squared: between a tenth of the robot and twice it.
    mass = 2.0 * energy[1:] / speed[1:] ** 2
    assert np.all((mass > 1.0) & (mass < 60.0))
    assert np.all(speed[1:] < np.array(SPEED_MPS[1:]) * 1.6 + 0.1)
    assert np.all(columns["contact_depth_m"].of_tile(result)[0][1:] > 0.0)


def test_a_pipe_sinks_at_its_terminal_speed_and_comes_to_rest_on_the_floor(touching):
    z = touching.obstacle_p[:, PIPE, 2]
    # Cylinder across the flow and caps as a sphere (Hoerner): weight in water over drag.
    area = 1.17 * 2.0 * RADIUS * LENGTH + 0.47 * np.pi * RADIUS**2
    weight = (DENSITY - 1000.0) * VOLUME * 9.81
    terminal = np.sqrt(weight / (0.5 * 1000.0 * area))
    high = (z < -24.7) & (z > FLOOR_M + 0.6)
    speed = -np.diff(z) / 0.1
    np.testing.assert_allclose(speed[high[:-1] & high[1:]][-3:], terminal, rtol=0.03)
    rest = touching.obstacle_p[-20:, PIPE]
    assert np.all(np.ptp(rest, axis=0) < 1e-3)
    # It is 2.4 mm where another robot presses on the floor, 0.01 mm where none does.
    assert abs(rest[-1, 2] - (FLOOR_M + RADIUS)) < 5e-3
    assert np.all(np.isfinite(touching.obstacle_p))
    _, x, y, _ = np.asarray(touching.end.obstacles.q)[0, PIPE]
    assert abs(1.0 - 2.0 * (x * x + y * y)) < 0.02


def test_a_pipe_longer_than_a_cell_lands_across_two_rocks(touching):
    p = touching.obstacle_p[:, LONG_PIPE]
    cell = float(np.asarray(touching.world.environment.grid.cell_m)[0])
    height = FLOOR_M + cell + RADIUS
    assert p[:, 2].min() > height - 0.03  # of an impact at its terminal speed
    assert abs(p[-1, 2] - height) < 3e-3
    assert np.all(np.ptp(p[-10:], axis=0) < 1e-3)
    assert np.all(np.abs(p[-1, :2] - LONG["position_m"][:2]) < 0.05)
    _, x, y, _ = np.asarray(touching.end.obstacles.q)[0, LONG_PIPE]
    assert abs(1.0 - 2.0 * (x * x + y * y)) < 1e-3


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"contacts": True, "engine": "fused"}, 'contacts.*fused.*"mjx"'),
        ({"contacts": True, "contact": {"robot": "cheese"}}, "robot.*cheese.*hdpe.*steel"),
        ({"contact": {"damage_energy_j": 3.0}}, "contact.damage_energy_j.*contacts = true"),
        ({"contact": {"floor": "rock"}}, "contact.floor.*contacts = true"),
        ({"contacts": True, "contact": {"damage_energy_j": 0.0}}, "contact.damage_energy_j"),
    ],
)
def test_wrong_tables_are_refused_by_name(changes, words, tmp_path):
    lines = ["schema_version = 1", 'name = "wrong"', f'engine = "{changes.get("engine", "mjx")}"']
    if "contacts" in changes:
        lines.append("contacts = true")
    lines += ["[world]", 'preset = "open"', "[[fleet]]", 'vehicle = "bluerov2_heavy"', "[contact]"]
    for key, value in changes.get("contact", {}).items():
        lines.append(f'{key} = "{value}"' if isinstance(value, str) else f"{key} = {value}")
    path = tmp_path / "wrong.toml"
    path.write_text("\n".join(lines))
    with pytest.raises(ConfigError, match=f"(?s){words}"):
        load_scenario(path)
