"""The Otter in the plane against Fossen's equations in three degrees of freedom.

Written here for u v r at CO, in x forward, y right, z down, with the numbers and the strips of the
published model; the vehicle file has cross-flow drag by squares of sway and yaw rate.
"""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError
from scipy.integrate import solve_ivp

from angler_mjx.robot.vehicles import library, mjcf, params
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.world.currents import Uniform

MASS, X_G, I_Z = 80.0, 0.1375, 14.4375
ADDED = np.diag([5.5, 82.5, 25.1427])
"""X_udot, Y_vdot and N_rdot of 0.1, 1.5 hulls and 1.7 inertias."""
CLOSED = ClosedForm(gravity_mps2=9.81)


def strips(v, r):
    """Cross-flow drag in sway and yaw at CO, strip by strip, as published."""
    at = np.linspace(-1.0, 1.0, 2001)
    force = 0.5 * 1026 * 0.195 * 1.0 * np.abs(v + at * r) * (v + at * r)
    return np.array([0.0, np.trapezoid(force, at), np.trapezoid(at * force, at)])


def squares(v, r):
    """The same by squares of sway and yaw rate at the centre of mass, as in the vehicle file."""
    v = v + X_G * r
    side = 200.0 * abs(v) * v - 27.7 * abs(r) * r
    turn = -27.5 * abs(v) * v + 55.2 * abs(r) * r
    return np.array([0.0, side, turn + X_G * side])


def fossen_rate(x, left, right, cross_flow):
    u, v, r = x
    M = np.array([[MASS, 0, 0], [0, MASS, MASS * X_G], [0, MASS * X_G, I_Z + MASS * X_G**2]])
    M = M + ADDED
    dry = np.array([-MASS * r * (X_G * r + v), MASS * u * r, MASS * X_G * u * r])
    # The Munk moment is left out, as published.
    water = np.array([-82.5 * v * r, 5.5 * u * r, 0.0])
    drag = np.array([77.55 * u, 0.0, 41.45 * (1.0 + 10.0 * abs(r)) * r])
    drag += cross_flow(v, r)
    thrust = np.array([left + right, 0.0, 0.395 * (left - right)])
    return np.linalg.solve(M, thrust - dry - water - drag)


@pytest.fixture(scope="module")
def otter(x64):
    return params.build_vehicle(library.load_vehicle("otter"), None, 16.0)


def swim(vehicle, engine, body, thrust, seconds, dt=0.01):
    current = (Uniform(velocity_mps=jnp.zeros(3)),)
    settled = jnp.asarray(thrust, float)

    @jax.jit
    def run():
        state = physics.VehicleState(
            p=jnp.array([0.0, 0.0, -1.5]),
            q=jnp.array([1.0, 0.0, 0.0, 0.0]),
            nu=jnp.zeros(6),
            force_before=jnp.zeros(6),
            thrust=settled,
        )
        zero, water = jnp.zeros(()), physics.Water()
        state = physics.start_multistep(engine, body, vehicle, state, current, zero, water)

        def one(state, _):
            after = physics.step(engine, body, vehicle, state, settled, current, zero, dt, water)
            return after, None

        return jax.lax.scan(one, state, None, round(seconds / dt))[0]

    return run()


@pytest.mark.parametrize("thrust", [(60.0, 60.0), (60.0, 20.0), (30.0, -20.0)])
@pytest.mark.parametrize(("cross_flow", "near"), [(squares, 0.005), (strips, 0.15)])
def test_speed_and_turn(otter, thrust, cross_flow, near):
    end = solve_ivp(
        lambda _, x: fossen_rate(x, *thrust, cross_flow), (0, 30), [0.0, 0.0, 0.0], rtol=1e-9
    )
    u, v, r = end.y[:, -1]
    nu = np.asarray(swim(otter, CLOSED, otter, thrust, 30.0).nu)
    # At CO the velocity to the right differs by the arm of the centre of mass.
    np.testing.assert_allclose(nu[[0, 5]], [u, -r], rtol=near, atol=1e-9)
    assert -nu[1] == pytest.approx(v + X_G * r, abs=0.3 * near)


def test_what_is_held_stays_where_it_is(otter):
    end = swim(otter, CLOSED, otter, [100.0, -60.0], 20.0)
    assert float(end.p[2]) == -1.5
    np.testing.assert_array_equal(end.nu[2:5], 0.0)
    np.testing.assert_array_equal(end.q[1:3], 0.0)
    assert abs(float(end.nu[5])) > 0.2


def test_engines_agree(otter):
    engine, body = mjx_engine.build_engine(
        [mjcf.to_spec(library.load_vehicle("otter"), None, shapes=False)]
    )
    ours = swim(otter, CLOSED, otter, [80.0, 30.0], 5.0)
    theirs = swim(otter, engine, jax.tree.map(lambda leaf: leaf[0], body), [80.0, 30.0], 5.0)
    for name in ("p", "q", "nu"):
        near = {"rtol": 1e-9, "atol": 1e-10}
        np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), **near)


def test_beside_others_in_a_fleet_both_move_as_alone(otter):
    heavy = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)
    fleet = params.stack_vehicles([otter, heavy])
    thrusts = (np.array([80.0, 30.0, 0, 0, 0, 0, 0, 0]), np.linspace(-10, 10, 8))
    for i, (alone, thrust) in enumerate(zip((otter, heavy), thrusts, strict=True)):
        one = jax.tree.map(lambda leaf, i=i: jnp.asarray(leaf)[i], fleet)
        together = swim(one, CLOSED, one, thrust, 3.0)
        n = alone.B.shape[1]
        apart = swim(alone, CLOSED, alone, thrust[:n], 3.0)
        np.testing.assert_allclose(together.nu, apart.nu, rtol=1e-9, atol=1e-12)
        np.testing.assert_allclose(together.p, apart.p, rtol=1e-9, atol=1e-12)


SCENE = {
    "name": "plane",
    "engine": "mjx",
    "world": {"preset": "open", "shape": [8, 8, 1], "floor_depth_m": 9.0},
    "fleet": [{"vehicle": "otter"}],
}


def test_water_more_than_one_cell_high_is_refused():
    Scenario.model_validate(SCENE)
    world = {**SCENE["world"], "shape": [8, 8, 2]}
    with pytest.raises(ValidationError, match="2 cells high"):
        Scenario.model_validate({**SCENE, "world": world})
    with pytest.raises(ValidationError, match="contact would lift it"):
        Scenario.model_validate({**SCENE, "contacts": True})
