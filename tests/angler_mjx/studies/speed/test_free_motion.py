"""The equations of motion alone: what is timed moves, and every vehicle on its own."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.studies.speed.measured import free_motion
from angler_mjx.studies.speed.measured.free_motion import require_different

VEHICLES = 5


@pytest.fixture(scope="module")
def begun():
    return jax.jit(free_motion.sample_states, static_argnums=(1, 2))(jax.random.key(3), VEHICLES, 8)


def moved(state, way):
    return replace(state, p=state.p + jnp.asarray(way)[:, None])


def test_every_vehicle_begins_at_its_own_velocity_under_its_own_thrusts(begun):
    state, thrust = begun
    low, high = free_motion.SPEED_MPS
    size = np.abs(np.asarray(state.nu))
    assert ((size >= low) & (size <= high)).all()
    assert len(np.unique(np.asarray(state.nu), axis=0)) == VEHICLES
    assert len(np.unique(np.asarray(thrust), axis=0)) == VEHICLES
    assert thrust.shape == state.thrust.shape == (VEHICLES, 8)
    # Both ways occur among 30 signs: by chance one in 2^29 keys has none of one kind.
    assert (np.asarray(state.nu) < 0).any()
    assert (np.asarray(state.nu) > 0).any()


def test_a_row_of_the_dynamics():
    row = free_motion.measure(vehicles=VEHICLES, repeats=10)
    assert (row.workload, row.worlds, row.robots) == ("dynamics", VEHICLES, 1)
    assert (row.engine, row.unit) == ("fused", "vehicle-steps/s")
    assert 0 < row.low <= row.median <= row.high
    assert row.repeats == 10
    # Two products of 6 x 6 matrices with vectors alone are 132 operations.
    assert 150 < row.flops < 5000
    # Each vehicle's p, q, nu, force, thrust and order in, all but the order out: 62 floats. Beside
    # them XLA counts its table of results, five addresses of 8 bytes.
    moved = row.least_bytes * VEHICLES * free_motion.STEPS
    assert 4 * VEHICLES * (35 + 27) <= round(moved) <= 4 * VEHICLES * (35 + 27) + 40
    assert row.xla_flops > 0
    assert row.xla_bytes > 0
    assert "1,000 physics steps" in row.inside


def test_a_cpu_gets_fewer_steps_of_many_vehicles():
    assert free_motion.steps_of(10**6, "gpu") == free_motion.STEPS
    assert free_motion.steps_of(64, "cpu") == free_motion.STEPS
    many = free_motion.steps_of(2**20, "cpu")
    assert free_motion.MIN_STEPS <= many < free_motion.STEPS


def test_vehicles_that_move_apart_pass(begun):
    require_different(begun[0], moved(begun[0], np.arange(1.0, 1.0 + VEHICLES)))


def test_nan_standing_and_alike_are_refused(begun):
    state, _ = begun
    apart = moved(state, np.arange(1.0, 1.0 + VEHICLES))
    with pytest.raises(RunError, match="NaN"):
        require_different(state, replace(apart, nu=apart.nu.at[2, 3].set(jnp.nan)))
    with pytest.raises(RunError, match="1 of 5 vehicles stood still"):
        require_different(state, moved(state, np.arange(VEHICLES)))
    with pytest.raises(RunError, match="4 moved as the one before"):
        require_different(state, moved(state, np.ones(VEHICLES)))


def test_kernels_of_another_device_are_refused():
    if jax.default_backend() == "gpu":
        pytest.skip("there is a GPU here")
    with pytest.raises(ConfigError, match="needs an NVIDIA GPU"):
        free_motion.measure(vehicles=128, repeats=10, kernels="cuda")
