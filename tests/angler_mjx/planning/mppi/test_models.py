"""One step of samples, and the wrench at rest, against closed forms in NumPy."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.mppi import drag, outputs
from angler_mjx.planning.mppi.models import ForceModel, ThrusterLag
from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.params import build_vehicle, stack_vehicles

YAW, DENSITY, GRAVITY, DT, RESPONSE = 0.7, 1025.0, 9.81, 0.1, 0.3
FLOW = np.array([0.2, -0.3, 0.1])


@pytest.fixture(scope="module")
def params():
    vehicles = stack_vehicles(
        [build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)]
    )
    both = ControlParams(
        vehicle=vehicles,
        allocation=allocation.build_allocation(vehicles),
        cruise_speed_mps=jnp.array([0.5]),
    )
    return jax.tree.map(lambda leaf: leaf[0], both)


@pytest.fixture(scope="module")
def hull(params):
    return drag.build_drag_hull(params, jnp.asarray(YAW), DENSITY, GRAVITY)


def body_from_world(x):
    c, s = np.cos(YAW), np.sin(YAW)
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]]) @ x


def settle(model, asked, flow):
    """Velocity over ground [3] in W after 60 s, and power."""

    def step(v, _):
        return model.step(v, jnp.asarray(asked)[:, None], jnp.asarray(flow), DT)

    v, power = jax.lax.scan(step, jnp.zeros((3, 1)), jnp.arange(600))
    return np.asarray(v)[:, 0], float(power[-1, 0])


@pytest.mark.parametrize("kind", [ThrusterLag, ForceModel])
def test_what_thrust_can_hold_is_held_and_takes_the_power_of_the_water_that_passes(hull, kind):
    model = kind(hull=replace(hull, lift_n=jnp.zeros(())), response_s=RESPONSE)
    ahead = 0.5 * np.array([np.cos(YAW), np.sin(YAW), 0.0])
    v, power = settle(model, ahead, np.zeros(3))
    np.testing.assert_allclose(v, ahead, atol=1e-5)
    assert power == pytest.approx(1.0, abs=1e-3)
    # To stand in a stream takes what going through still water takes.
    v, power = settle(model, np.zeros(3), ahead)
    np.testing.assert_allclose(v, 0.0, atol=1e-5)
    assert power == pytest.approx(1.0, abs=1e-3)
    v, power = settle(model, ahead, ahead)
    assert power == pytest.approx(0.0, abs=1e-3)


@pytest.mark.parametrize("kind", [ThrusterLag, ForceModel])
def test_water_that_is_faster_than_the_robot_takes_it_along(hull, params, kind):
    model = kind(hull=hull, response_s=RESPONSE)
    bow = np.array([np.cos(YAW), np.sin(YAW), 0.0])
    v, _ = settle(model, np.zeros(3), 3.0 * bow)
    most = float(params.vehicle.terminal_speed_mps[0])
    assert 3.0 - most - 0.02 < v @ bow < 3.0 - 0.8 * most
    np.testing.assert_allclose(v - (v @ bow) * bow, 0.0, atol=1e-4)


def test_forces_end_at_the_speed_at_which_drag_is_all_their_thrust(hull):
    """Root of D_l v + D_q v^2 = F, F by hand from the thrusters' share of a force ahead."""
    bow = np.array([np.cos(YAW), np.sin(YAW), 0.0])
    v, _ = settle(ForceModel(hull=hull, response_s=RESPONSE), 9.0 * bow, np.zeros(3))
    most = float(hull.max_thrust_n) / np.abs(np.asarray(hull.thrusters)[:, 0]).max()
    linear, quadratic = float(hull.linear[0]), float(hull.quadratic[0])
    root = (-linear + np.sqrt(linear**2 + 4 * quadratic * most)) / (2 * quadratic)
    assert v @ bow == pytest.approx(root, rel=1e-3)


def test_forces_at_their_limit_accelerate_the_mass_with_added_mass(hull, params):
    """One step from rest along the bow: (m + m_a + dt D_l) v = dt F, lift left out."""
    bow = np.array([np.cos(YAW), np.sin(YAW), 0.0])
    model = ForceModel(hull=replace(hull, lift_n=jnp.zeros(())), response_s=RESPONSE)
    v, _ = model.step(jnp.zeros((3, 1)), jnp.asarray(9.0 * bow)[:, None], jnp.zeros(3), DT)
    force = float(hull.max_thrust_n) / np.abs(np.asarray(hull.thrusters)[:, 0]).max()
    inertia = float(params.vehicle.mass_kg + params.vehicle.M_A[0, 0])
    expected = DT * force / (inertia + DT * float(params.vehicle.D_l[0]))
    assert float(v[:, 0] @ bow) == pytest.approx(expected, rel=1e-4)


def test_forces_without_limit_answer_as_a_lag_does(hull):
    strong = replace(hull, max_thrust_n=jnp.asarray(1e9), fastest_mps=jnp.full(3, 1e9))
    rows = np.random.default_rng(2).normal(size=(2, 3, 20)).astype(np.float32)
    v, asked = jnp.asarray(rows[0]), jnp.asarray(rows[1])
    flow = jnp.asarray(FLOW)
    by_force, _ = ForceModel(hull=strong, response_s=RESPONSE).step(v, asked, flow, DT)
    expected = rows[1] + (rows[0] - rows[1]) * np.exp(-DT / RESPONSE)
    np.testing.assert_allclose(by_force, expected, atol=1e-4)


def test_the_wrench_at_rest_carries_net_weight_and_what_the_stream_does(params):
    half = YAW / 2
    q = jnp.array([np.cos(half), 0.0, 0.0, np.sin(half)])
    zero, vehicle = jnp.zeros(3), params.vehicle
    told = outputs.build_wrench(
        vehicle,
        Estimate(p=zero, q=q, nu=jnp.zeros(6), flow=jnp.asarray(FLOW)),
        zero,
        jnp.asarray(YAW),
        2.5,
        RESPONSE,
        DENSITY,
        GRAVITY,
    )
    through = -body_from_world(FLOW)
    linear, quadratic = np.asarray(vehicle.D_l)[:3], np.asarray(vehicle.D_q)[:3]
    force = (linear + quadratic * np.abs(through)) * through
    buoyancy = DENSITY * GRAVITY * float(vehicle.volume_m3)
    up = np.array([0.0, 0.0, 1.0])
    force = force + (float(vehicle.mass_kg) * GRAVITY - buoyancy) * up
    added = np.asarray(vehicle.M_A)[:3, :3] @ through
    moment = np.cross(through, added) - np.cross(np.asarray(vehicle.p_cb_m), buoyancy * up)
    np.testing.assert_allclose(told.tau, np.concatenate([force, moment]), atol=2e-3)


def test_the_wrench_takes_up_a_velocity_by_the_mass_with_added_mass(params):
    level = jnp.array([1.0, 0.0, 0.0, 0.0])
    numbers = (jnp.asarray(0.0), 2.5, RESPONSE, DENSITY, GRAVITY)
    rest = Estimate(p=jnp.zeros(3), q=level, nu=jnp.zeros(6), flow=None)
    hold = outputs.build_wrench(params.vehicle, rest, jnp.zeros(3), *numbers).tau
    ahead = outputs.build_wrench(params.vehicle, rest, jnp.array([0.3, 0.0, 0.0]), *numbers).tau
    inertia = float(params.vehicle.mass_kg + params.vehicle.M_A[0, 0])
    assert float(ahead[0] - hold[0]) == pytest.approx(inertia * 0.3 / RESPONSE, rel=1e-5)


def test_the_wrench_returns_to_the_heading_with_critical_damping(params):
    """Angular acceleration k^2 e - 2 k r about z, of the error e and the yaw rate r."""
    k, rate, error = 2.5, 0.4, 0.3
    level = jnp.array([1.0, 0.0, 0.0, 0.0])
    turning = Estimate(
        p=jnp.zeros(3), q=level, nu=jnp.array([0.0, 0.0, 0.0, 0.0, 0.0, rate]), flow=None
    )

    def moment(attitude_per_s):
        numbers = (jnp.asarray(error), attitude_per_s, RESPONSE, DENSITY, GRAVITY)
        return float(outputs.build_wrench(params.vehicle, turning, jnp.zeros(3), *numbers).tau[5])

    inertia = float(params.vehicle.inertia_kgm2[2, 2] + params.vehicle.M_A[5, 5])
    expected = inertia * (k**2 * 2.0 * np.sin(error / 2.0) - 2.0 * k * rate)
    assert moment(k) - moment(0.0) == pytest.approx(expected, rel=1e-4)


def test_thrusters_that_differ_are_cut_at_their_own_ends():
    """One thruster of at most 6 N, weaker astern, in the column of surge: it bounds the force."""
    data = library.load_vehicle("bluerov2_heavy").model_dump()
    curve = {"pwm_us": [1100, 1500, 1900], "thrust_n": [-6.0, 0.0, 9.0]}
    data["thrusters"]["layout"][2]["curve"] = curve
    weak = VehicleConfig.model_validate(data)
    vehicles = stack_vehicles([build_vehicle(weak, "wu2018", 16.0)])
    both = ControlParams(
        vehicle=vehicles,
        allocation=allocation.build_allocation(vehicles),
        cruise_speed_mps=jnp.array([0.5]),
    )
    params = jax.tree.map(lambda leaf: leaf[0], both)
    hull = drag.build_drag_hull(params, jnp.asarray(YAW), DENSITY, GRAVITY)
    strong = float(min(vehicles.thrust_n[0, 0, -1], -vehicles.thrust_n[0, 0, 0]))
    limit = np.full(8, strong)
    limit[2] = 6.0
    demand = np.array([[500.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 300.0]]).T
    force, thrust = (np.asarray(x) for x in drag.allocate_thrust(hull, jnp.asarray(demand)))
    assert np.all(np.abs(thrust) <= limit[:, None] * (1 + 1e-5))
    # Surge is cut to the weak thruster's end; a small demand is met, and heave runs without it.
    per_newton = np.asarray(hull.thrusters)
    assert force[0, 0] == pytest.approx(6.0 / abs(per_newton[2, 0]), rel=1e-4)
    np.testing.assert_allclose(force[:, 1], demand[:, 1], rtol=1e-5)
    assert force[2, 2] == pytest.approx(
        min(strong / np.abs(per_newton[:, 2]).max(), 300.0), rel=1e-4
    )
