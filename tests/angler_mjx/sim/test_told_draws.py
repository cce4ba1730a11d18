"""What robots are told is disturbed by numbers of their own: put together as a run does it."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import quaternion
from angler_mjx.robot.control.navigation import NavigationParams
from angler_mjx.robot.sensing import instruments, params
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.sim import sensing
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import InstrumentedRobots, SimSpec
from angler_mjx.world.rock.grid import Grid

from ..independence import assert_uncorrelated

N = 2000
"""Robots of one world, all at the same place."""


def crew(source):
    """All robots, told in the same way."""
    one = NavigationParams(sensors=params.build_sensors(SensorsConfig(), 0.05, 9.81))
    each = jax.tree.map(lambda x: jnp.broadcast_to(jnp.asarray(x), (N, *jnp.shape(x))), one)
    return SimSpec(instrumented=(InstrumentedRobots(first=0, count=N, source=source, params=each),))


@pytest.fixture(scope="module")
def world():
    """Keys of robots, as a run makes them, over an empty cell."""
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(9), jnp.arange(N))
    grid = Grid(
        occupied=jnp.zeros((1, 1, 1), bool),
        origin_m=jnp.array([-5.0, -5.0, -10.0]),
        cell_m=jnp.asarray(10.0),
    )
    return SimpleNamespace(
        factors=None,
        environment=SimpleNamespace(grid=grid, floor_z_m=jnp.asarray(-10.0)),
        sensing_key=jax.random.key_data(keys),
    )


@pytest.fixture(scope="module")
def vehicles():
    return VehicleState(
        p=jnp.tile(jnp.array([1.0, 2.0, -5.0]), (N, 1)),
        q=jnp.tile(quaternion.exp(jnp.array([0.1, -0.2, 0.3])), (N, 1)),
        nu=jnp.zeros((N, 6)),
        force_before=jnp.zeros((N, 6)),
        thrust=jnp.zeros((N, 8)),
    )


def turned(vehicles, q):
    """[N, 3] rad about the axes of W."""
    off = jax.vmap(instruments.rotation_between)(vehicles.q, q)
    return jax.vmap(quaternion.rotate)(vehicles.q, off)


def side_by_side(groups):
    names = [f"{name} {i}" for name, rows in groups.items() for i in range(rows.shape[1])]
    return np.concatenate(list(groups.values()), axis=1), names


def test_instruments_and_filter_begin_with_errors_of_their_own(world, vehicles):
    (begun,) = jax.jit(lambda: sensing.reset(crew("ekf"), world, vehicles))()
    assert_uncorrelated(
        *side_by_side(
            {
                "gyro": begun.instruments.gyro_turn_on,
                "accelerometer": begun.instruments.accel_turn_on,
                "surface": begun.instruments.surface_m[:, None],
                "heading": begun.instruments.heading_bias_rad[:, None],
                "hard iron": begun.instruments.hard_iron,
                "position": begun.filter.p,
                "velocity": begun.filter.v,
                "attitude": turned(vehicles, begun.filter.q),
            }
        )
    )


def test_noise_on_the_truth_is_new_at_every_step_axis_and_robot(world, vehicles):
    @jax.jit
    def told(step):
        flow = jnp.zeros((N, 3))
        return sensing.step(crew("noisy"), world, (None,), step, vehicles, flow)[1]

    groups = {}
    for step in (0, 1):
        belief = told(jnp.int32(step))
        groups |= {
            f"position at {step}": belief.p,
            f"attitude at {step}": turned(vehicles, belief.q),
            f"velocity at {step}": belief.nu,
            f"current at {step}": belief.flow,
        }
    numbers, names = side_by_side(groups)
    assert_uncorrelated(numbers, names)
    # And of one robot to the next.
    later = [f"{name}, next robot" for name in names]
    assert_uncorrelated(np.concatenate([numbers[1:], numbers[:-1]], axis=1), names + later)
