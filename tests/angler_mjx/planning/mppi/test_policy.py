"""Memory at the start, and the model of each output, from calls of the policy itself."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.mppi.policy import Mppi
from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.params import build_vehicle, stack_vehicles
from angler_mjx.sim.policy import PolicyInput
from angler_mjx.sim.record import Belief
from angler_mjx.world.rock.grid import Grid

from ...compiling import quickly

START, SPEED, CRUISE, DT = np.array([[-1.0, 0.5, -3.0]]), 0.4, 0.5, 0.5
POLICY = Mppi(samples=2, horizon_s=1.5, dt_s=DT, knots=3)


@pytest.fixture(scope="module")
def known():
    """Inputs of one robot that moves ahead, to the east, in open water without a current."""
    vehicles = stack_vehicles(
        [build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)]
    )
    zero = jnp.zeros((1, 3))
    return PolicyInput(
        belief=Belief(
            p=jnp.asarray(START),
            q=jnp.array([[1.0, 0.0, 0.0, 0.0]]),
            nu=jnp.array([[SPEED, 0.0, 0.0, 0.0, 0.0, 0.0]]),
            flow=None,
            position_std_m=zero,
            velocity_std_mps=zero,
            attitude_std_rad=zero,
        ),
        time_s=jnp.zeros(()),
        goal_m=jnp.array([[2.0, 0.5, -3.0]]),
        path=(),
        params=ControlParams(
            vehicle=vehicles,
            allocation=allocation.build_allocation(vehicles),
            cruise_speed_mps=jnp.array([CRUISE]),
        ),
        grid=Grid(
            occupied=jnp.zeros((4, 4, 4), bool),
            origin_m=jnp.array([-3.0, -3.0, -6.0]),
            cell_m=jnp.asarray(1.5),
        ),
        floor_z_m=jnp.asarray(-6.0),
    )


@pytest.fixture(scope="module")
def memory(known):
    return quickly(POLICY.reset)(known, jax.random.key(0))


def test_robots_mean_to_stand_where_they_start(memory):
    np.testing.assert_array_equal(memory.knots, np.zeros((1, 3, 3)))
    np.testing.assert_array_equal(memory.path_m, np.repeat(START[:, None], 3, axis=1))
    np.testing.assert_array_equal(memory.yaw_rad, np.zeros(1))


@pytest.mark.parametrize("output", ["twist", "wrench"])
def test_twists_are_planned_by_the_lag_and_wrenches_by_the_forces(known, memory, output):
    """One step of a robot whose thrusters do next to nothing, with drag linear at that step."""
    vehicle = known.params.vehicle
    weak = replace(vehicle, thrust_n=1e-4 * vehicle.thrust_n, volume_m3=vehicle.mass_kg / 1000.0)
    known = replace(known, params=replace(known.params, vehicle=weak))
    after, _ = quickly(replace(POLICY, output=output).act)(
        memory, known, jax.random.key(1), jnp.int32(0)
    )
    if output == "twist":
        asked = float(after.knots[0, 0, 0])
        speed = asked + (SPEED - asked) * np.exp(-DT / POLICY.weights.response_s)
    else:
        mass = float(vehicle.mass_kg[0] + vehicle.M_A[0, 0, 0])
        damping = float(vehicle.D_l[0, 0] + vehicle.D_q[0, 0] * SPEED)
        speed = mass * SPEED / (mass + DT * damping)
    expected = START[0, 0] + DT * (SPEED + speed) / 2.0
    assert float(after.path_m[0, 0, 0]) == pytest.approx(expected, abs=1e-3)
