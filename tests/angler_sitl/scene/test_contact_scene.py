"""Bodies that touch and hold each other in the lock-step, beside the simulator's own contact."""

import copy

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import Outcome, Touched
from angler_sitl.scene.scene import AutopilotScene
from angler_sitl.spotcheck.world_flyers import select_fleet

PIPE = {
    "type": "capsule",
    "radius_m": 0.05,
    "length_m": 2.0,
    "position_m": [-1.0, -1.0, -6.0],
    "rpy_deg": [0.0, 90.0, 0.0],
    "mass_kg": 18.5,
    "motion": {"type": "drift"},
}
CARRIED = {
    "name": "carried",
    "engine": "mjx",
    "contacts": True,
    "time": {"horizon_s": 40.0, "physics_dt_s": 0.0025},  # that of the lock-step
    "task": {
        "type": "carry",
        "offset_m": [0.0, 0.0, 0.55],
        "to_m": [0.5, 0.5, -7.0],
        "turn_deg": 60.0,
    },
    "world": {"preset": "open", "shape": [8, 8, 6], "obstacles": {"explicit": [PIPE]}},
    "fleet": [
        {
            "vehicle": "bluerov2_heavy",
            "parameter_set": "wu2018",
            "count": 2,
            "cruise_speed_mps": 0.4,
        }
    ],
}
BOX = {
    "type": "box",
    "size_m": [0.6, 1.5, 1.5],
    "position_m": [1.0, 0.0, -6.0],
    "mass_kg": 1350.0,  # as much as the water that it displaces
    "motion": {"type": "drift"},
}
PUSHING = {
    "name": "pushing",
    "engine": "mjx",
    "contacts": True,
    "time": {"horizon_s": 20.0, "physics_dt_s": 0.0025},
    "world": {
        "preset": "open",
        "shape": [8, 8, 6],
        "placement": "given",
        "start_m": [[0.0, 0.0, -6.0]],
        "goal_m": [[4.0, 0.0, -6.0]],
        "obstacles": {"explicit": [BOX]},
    },
    "fleet": [{"vehicle": "bluerov2_heavy", "parameter_set": "wu2018"}],
}


def build(table, **task):
    table = copy.deepcopy(table)
    if task:
        table["task"].update(task)
    return AutopilotScene(Scenario.model_validate(table))


@pytest.fixture(scope="module")
def scene():
    return build(CARRIED)


@pytest.fixture
def afloat(scene):
    scene.reset()
    scene.moored = False
    return scene


def signals(count, robots, seed=1, reach=90):
    rng = np.random.default_rng(seed)
    pwm = np.full((count, robots, 16), 1500, np.int32)
    pwm[:, :, :8] += rng.integers(-reach, reach, (count, robots, 8), dtype=np.int32)
    return pwm


def fly_both(scene, series):
    """Return the scene's state and the simulator's after the same signals."""
    worlds, simulator = scene.worlds, scene.simulator
    theirs = simulator.reset(worlds)
    for pwm in series:
        for _ in range(scene.steps_per_period):
            scene.step(pwm)
        scene.judge()
        command = ThrusterPwm(pwm_us=pwm[None, :, :8].astype(theirs.vehicles.p.dtype))
        theirs, _ = simulator.step(worlds, theirs, command)
    return scene.state, theirs


def assert_moved_alike(ours, theirs):
    # float32 there, float64 here: 1,200 steps of half an ulp of 10 m, and the tolerance of solvers.
    for mine, other in ((ours.vehicles, theirs.vehicles), (ours.obstacles, theirs.obstacles)):
        np.testing.assert_allclose(mine.p, other.p, atol=1e-3)
        np.testing.assert_allclose(mine.q, other.q, atol=1e-3)
        np.testing.assert_allclose(mine.nu, other.nu, atol=1e-3)
    assert np.array_equal(ours.tally.outcome, theirs.tally.outcome)


def test_a_pipe_and_its_carriers_move_as_in_the_simulator(afloat):
    start = np.asarray(afloat.state.obstacles.p).copy()
    ours, theirs = fly_both(afloat, signals(60, 2))
    assert_moved_alike(ours, theirs)
    assert np.array_equal(ours.grips.held, theirs.grips.held)
    # What wrists measure, the mean of a period: some 10 N and 1 N m.
    np.testing.assert_allclose(ours.grips.wrench, theirs.grips.wrench, atol=0.05)
    assert np.abs(np.asarray(ours.grips.wrench)).max() > 3.0
    for name in ("distance_m", "angle_rad"):
        np.testing.assert_allclose(
            getattr(ours.tally.cargo_error, name),
            getattr(theirs.tally.cargo_error, name),
            atol=1e-3,
        )
    # Peaks of single steps, which rounding moves more than what they sum to.
    np.testing.assert_allclose(ours.tally.grip_force_n, theirs.tally.grip_force_n, rtol=0.02)
    np.testing.assert_allclose(
        ours.tally.internal_force_n, theirs.tally.internal_force_n, rtol=0.02
    )
    assert np.linalg.norm(np.asarray(ours.obstacles.p) - start) > 0.1  # it went somewhere


def test_accelerations_of_carriers_sum_to_their_velocities(afloat):
    gravity = np.array([0.0, 0.0, 9.80665])
    velocity = afloat.states.v_ned.copy()
    for pwm in signals(5, 2, seed=2):
        for _ in range(afloat.steps_per_period):
            now = afloat.step(pwm)
            for robot in range(2):
                w, x, y, z = now.q[robot]
                to_ned = np.array(
                    [
                        [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
                        [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
                        [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
                    ]
                )
                velocity[robot] += afloat.dt_s * (to_ned @ now.accel_body[robot] + gravity)
            np.testing.assert_allclose(velocity, now.v_ned, atol=1e-11)
        afloat.judge()
    assert np.abs(velocity).max() > 0.02


def test_a_reset_takes_hold_again_and_repeats_the_flight(afloat):
    first, _ = fly_both(afloat, signals(10, 2))
    at_start = np.asarray(afloat.worlds.environment.obstacles.p0)
    afloat.reset()
    np.testing.assert_allclose(afloat.state.obstacles.p, at_start, atol=1e-6)
    assert np.all(afloat.state.grips.held)
    afloat.moored = False
    again, _ = fly_both(afloat, signals(10, 2))
    for name in ("p", "q", "nu"):
        assert np.array_equal(getattr(first.obstacles, name), getattr(again.obstacles, name))
        assert np.array_equal(getattr(first.vehicles, name), getattr(again.vehicles, name))


def test_a_moored_pipe_waits_for_the_autopilots(scene):
    scene.reset()
    before = np.asarray(scene.state.obstacles.p).copy()
    for _ in range(40):
        scene.step(np.full((2, 16), 1700, np.int32))
    scene.moored = False
    for _ in range(scene.steps_per_period):
        scene.step(np.full((2, 16), 1500, np.int32))
    scene.judge()
    # Half of 0.05 s of the fall of a body that weighs 15 N in water is below a centimetre.
    np.testing.assert_allclose(scene.state.obstacles.p, before, atol=0.01)


def test_a_grip_that_breaks_ends_the_episode_as_in_the_simulator():
    scene = build(CARRIED, break_force_n=8.0)
    scene.moored = False
    apart = np.full((30, 2, 16), 1500, np.int32)
    apart[:, :, :8] = signals(1, 2, seed=5, reach=250)[0, :, :8]
    ours, theirs = fly_both(scene, apart)
    assert np.array_equal(ours.tally.outcome, theirs.tally.outcome)
    assert Outcome.DROPPED in np.asarray(ours.tally.outcome)
    assert np.array_equal(ours.grips.held, theirs.grips.held)
    assert not np.all(ours.grips.held)


def test_a_pipe_is_released_at_its_goal_as_in_the_simulator():
    scene = build(CARRIED, to_m=[-0.98, -1.0, -6.0], turn_deg=0.0, hold_s=0.5, release=True)
    scene.moored = False
    ours, theirs = fly_both(scene, np.full((60, 2, 16), 1500, np.int32))
    assert not np.any(ours.grips.held)
    assert np.array_equal(ours.grips.held, theirs.grips.held)
    assert np.all(np.asarray(ours.tally.outcome) == Outcome.REACHED)
    np.testing.assert_allclose(ours.tally.end_time_s, theirs.tally.end_time_s, atol=1e-4)
    np.testing.assert_allclose(ours.obstacles.p, theirs.obstacles.p, atol=2e-3)
    assert float(ours.obstacles.p[0, 0, 2]) < -6.5  # it sank


def test_a_robot_pushes_a_box_as_in_the_simulator():
    scene = build(PUSHING)
    scene.moored = False
    forward = np.full((1, 16), 1500, np.int32)
    forward[0, :4] = [1400, 1400, 1600, 1600]  # its four horizontal thrusters
    start = np.asarray(scene.state.obstacles.p).copy()
    ours, theirs = fly_both(scene, np.repeat(forward[None], 100, 0))
    assert int(ours.tally.touched[0, 0]) == Touched.OBSTACLE
    assert int(ours.tally.outcome[0, 0]) == Outcome.RUNNING
    np.testing.assert_allclose(ours.tally.impact_energy_j, theirs.tally.impact_energy_j, rtol=0.02)
    assert float(ours.tally.impact_energy_j[0, 0]) > 0.1
    np.testing.assert_allclose(ours.obstacles.p, theirs.obstacles.p, atol=5e-3)
    assert np.asarray(ours.obstacles.p - start)[0, 0, 0] > 0.01


def test_carriers_are_not_flown_without_each_other():
    scenario = Scenario.model_validate(CARRIED)
    assert select_fleet(scenario, 2) is scenario
    with pytest.raises(ConfigError, match="--robots 1: the 2 robots of the run carry"):
        select_fleet(scenario, 1)
