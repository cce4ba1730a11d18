import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import ThrusterPwm
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import Outcome
from angler_sitl.scene.scene import AutopilotScene

SCENARIO = {
    "name": "two_kinds",
    "seed": 5,
    "time": {"horizon_s": 20.0, "physics_dt_s": 0.0025},  # that of the lock-step
    "world": {
        "preset": "open",
        "obstacles": {"dynamic": {"count": 2, "radius_m": [0.4, 0.6]}},
        "currents": [{"type": "vortices", "count": 2, "peak_speed_mps": [0.2, 0.4]}],
    },
    "fleet": [{"vehicle": "bluerov2_heavy"}, {"vehicle": "bluerov2"}],
}
WORLD = 3
NEUTRAL = np.full((2, 16), 1500, np.int32)


@pytest.fixture(scope="module")
def scene():
    return AutopilotScene(Scenario.model_validate(SCENARIO), world=WORLD)


@pytest.fixture
def afloat(scene):
    scene.reset()
    scene.moored = False
    return scene


def series(count, seed=1):
    """Signals of each control period [count, 2, 16]."""
    rng = np.random.default_rng(seed)
    signals = np.full((count, 2, 16), 1500, np.int32)
    signals[:, :, :8] += rng.integers(-90, 90, (count, 2, 8), dtype=np.int32)
    return signals


def matrix(q):
    """FRD to NED."""
    w, x, y, z = q
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def test_the_same_signals_make_the_same_way_as_in_the_simulator(afloat):
    scene, worlds, simulator = afloat, afloat.worlds, afloat.simulator
    theirs = simulator.reset(worlds)
    for pwm in series(60):
        for _ in range(scene.steps_per_period):
            scene.step(pwm)
        scene.judge()
        command = ThrusterPwm(pwm_us=pwm[None, :, :8].astype(theirs.vehicles.p.dtype))
        theirs, _ = simulator.step(worlds, theirs, command)
    ours = scene.state
    # float32 there, float64 here: at 25 m each of 1,200 steps rounds a position by up to 1 um, and
    # a steady velocity always the same way.
    np.testing.assert_allclose(ours.vehicles.p, theirs.vehicles.p, atol=1.2e-3)
    # 1,200 times half of 1.2e-7, and what differs in position and rate because of it.
    np.testing.assert_allclose(ours.vehicles.q, theirs.vehicles.q, atol=2e-4)
    np.testing.assert_allclose(ours.vehicles.nu, theirs.vehicles.nu, atol=2e-4)
    # Moved by the same code in the same type.
    np.testing.assert_allclose(ours.obstacles.p, theirs.obstacles.p, atol=1e-5)
    assert np.array_equal(ours.tally.outcome, theirs.tally.outcome)
    np.testing.assert_allclose(
        ours.tally.min_clearance_m, theirs.tally.min_clearance_m, atol=1.2e-3
    )
    np.testing.assert_allclose(ours.tally.path_length_m, theirs.tally.path_length_m, atol=1e-3)
    np.testing.assert_allclose(ours.tally.energy_j, theirs.tally.energy_j, rtol=1e-4)
    moved = np.linalg.norm(np.asarray(ours.vehicles.p - scene.worlds.environment.start_m), axis=-1)
    assert moved.min() > 0.1  # the comparison is of something


def test_a_step_gives_the_types_that_it_takes(afloat):
    """A result of another type, weak or not, has the second step traced again."""
    worlds, simulator = afloat.worlds, afloat.simulator
    first = simulator.reset(worlds)
    command = ThrusterPwm(pwm_us=jnp.full((1, 2, 8), 1500, first.vehicles.p.dtype))
    second, _ = simulator.step(worlds, first, command)

    def types(state):
        return [(x.shape, x.dtype, x.weak_type) for x in jax.tree.leaves(state)]

    assert types(second) == types(first)


def test_accelerations_sum_to_the_velocities(afloat):
    gravity = np.array([0.0, 0.0, 9.80665])
    velocity = afloat.states.v_ned.copy()
    for pwm in series(10, seed=2):
        for _ in range(afloat.steps_per_period):
            now = afloat.step(pwm)
            for i in range(2):
                velocity[i] += afloat.dt_s * (matrix(now.q[i]) @ now.accel_body[i] + gravity)
            # float64 throughout: 200 steps of some 1e-16 m/s.
            np.testing.assert_allclose(velocity, now.v_ned, atol=1e-11)
        afloat.judge()
    assert np.abs(velocity).max() > 0.05


def test_velocities_and_rates_are_those_of_the_poses(afloat):
    before = afloat.states
    for _ in range(40):
        before = afloat.step(series(1, seed=4)[0])
    for _ in range(20):
        now = afloat.step(series(1, seed=4)[0])
        mean = 0.5 * (now.v_ned + before.v_ned)
        # Of second order: the step's square times how fast accelerations change, some 100 m/s^3.
        np.testing.assert_allclose((now.p_ned - before.p_ned) / afloat.dt_s, mean, atol=1e-3)
        for i in range(2):
            turn = matrix(before.q[i]).T @ matrix(now.q[i])
            rate = np.array([turn[2, 1], turn[0, 2], turn[1, 0]]) / afloat.dt_s
            middle = 0.5 * (now.gyro[i] + before.gyro[i])
            np.testing.assert_allclose(rate, middle, atol=1e-3)
        before = now


def test_no_pulse_is_no_thrust(afloat):
    def end(pulse):
        afloat.reset()
        afloat.moored = False
        for _ in range(40):
            states = afloat.step(np.full((2, 16), pulse, np.int32))
        return states.numbers.copy()

    drifting = end(1500)
    for pulse in (0, 899, 2101, 65_535):
        np.testing.assert_array_equal(end(pulse), drifting)
    assert np.abs(end(900) - drifting).max() > 0.1
    np.testing.assert_array_equal(end(900), end(1100))  # the lowest signal of the curve


def test_moored_vehicles_rest_at_their_starts_while_clocks_run(scene):
    scene.reset()
    start = np.asarray(scene.worlds.environment.start_m)[0]
    for _ in range(10):
        states = scene.step(np.full((2, 16), 1900, np.int32))
    assert scene.time_s == 10 * scene.dt_s
    north_east_down = np.stack([start[:, 1], start[:, 0], -start[:, 2]], axis=1)
    # Starts are drawn in float32.
    np.testing.assert_allclose(states.p_ned, north_east_down, atol=1e-6)
    np.testing.assert_allclose(states.accel_body, [[0, 0, -9.80665]] * 2, atol=1e-12)
    assert not states.v_ned.any()
    assert not states.gyro.any()
    assert int(scene.state.step[0]) == 0


def test_nobody_flies_out_of_the_water(afloat):
    # Thrusters 5 to 8 push down for pulses above 1500.
    up = NEUTRAL.copy()
    up[:, 4:8] = 1100
    highest = -np.inf
    for _ in range(800):  # 40 s from 25 m, at 0.8 m/s
        for _ in range(afloat.steps_per_period):
            highest = max(highest, float(-afloat.step(up).p_ned[:, 2].min()))
        afloat.judge()
    outcome = np.asarray(afloat.state.tally.outcome)[0]
    assert (outcome == Outcome.OUT_OF_BOUNDS).all()
    # The region's top is under water; they are held there within one period, at 2 m/s at most.
    assert highest < 0.1
    still = afloat.step(up)
    assert not still.v_ned.any()
    np.testing.assert_allclose(np.linalg.norm(still.accel_body, axis=1), 9.80665, rtol=1e-9)


def test_another_seed_is_another_world_and_the_same_seed_the_same(scene):
    scene.reset()
    first = scene.states.numbers.copy()
    scene.reset(seed=6)
    other = scene.states.numbers.copy()
    scene.reset()
    np.testing.assert_array_equal(scene.states.numbers, first)
    assert np.abs(other - first).max() > 0.1


def test_a_control_period_must_be_whole_steps():
    with pytest.raises(ConfigError, match=r"control_dt_s = 0\.05.*steps of 3 ms"):
        AutopilotScene(Scenario.model_validate(SCENARIO), dt_s=0.003)
