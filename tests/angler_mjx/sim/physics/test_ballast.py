"""Ballast and moving masses: the glider's published equations, and motions in closed form.

The Sea-Wing's equations are those of Zhang et al. (Ocean Engineering 60, 2013), written here from
their coefficients: x forward, y right, z down, origin at the centre of buoyancy, forces along and
across the flow.
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.optimize import fsolve
from scipy.spatial.transform import Rotation

from angler_mjx.robot.vehicles import glide, library, mjcf, params, trim
from angler_mjx.sim.physics import mjx_engine
from angler_mjx.sim.physics import step as physics
from angler_mjx.sim.physics.closed_form import ClosedForm
from angler_mjx.world.currents import Uniform

G = 9.81
CLOSED = ClosedForm(gravity_mps2=G)
SEA = physics.Water(density_kgpm3=1025.0)
HULL_KG, BATTERY_KG, OFFSET_M = 54.28, 11.0, 0.014
HULL_M = np.array([-0.0814, 0.0, 0.0032])
MIDDLE_M = 0.401672


def spiral_rest(x, battery, heavy_kg):
    """Force and moment [6] left over in a steady spiral of V, alpha, beta, pitch, roll, turn."""
    V, alpha, beta, pitch, roll, turn = x
    v = V * np.array([np.cos(alpha) * np.cos(beta), np.sin(beta), np.sin(alpha) * np.cos(beta)])
    down = np.array([-np.sin(pitch), np.sin(roll) * np.cos(pitch), np.cos(roll) * np.cos(pitch)])
    omega = turn * down
    flow = (
        V
        * V
        * np.array(
            [
                -(7.19 + 386.29 * alpha**2),
                -115.65 * beta,
                -(-0.36 + 440.99 * alpha),
                -58.27 * beta - 19.83 * omega[0],
                0.28 - 65.84 * alpha - 205.64 * omega[1],
                34.10 * beta - 389.30 * omega[2],
            ]
        )
    )
    to_body = np.array(
        [
            [np.cos(alpha) * np.cos(beta), -np.cos(alpha) * np.sin(beta), -np.sin(alpha)],
            [np.sin(beta), np.cos(beta), 0.0],
            [np.sin(alpha) * np.cos(beta), -np.sin(alpha) * np.sin(beta), np.cos(alpha)],
        ]
    )
    first = HULL_KG * HULL_M + BATTERY_KG * battery
    added = np.array([[0, 0, 0], [0, 0, 3.61], [0, 2.57, 0]])
    inertia = np.diag([0.62 + 0.53, 15.44 + 7.88, 15.49 + 10.18])
    for mass, at in ((HULL_KG, HULL_M), (BATTERY_KG, battery)):
        inertia += mass * (at @ at * np.eye(3) - np.outer(at, at))
    P = (HULL_KG + BATTERY_KG + np.array([1.48, 49.58, 65.92])) * v
    P = P + added @ omega + np.cross(omega, first)
    L = added.T @ v + np.cross(first, v) + inertia @ omega
    force = np.cross(P, omega) + heavy_kg * G * down + to_body @ flow[:3]
    moment = np.cross(L, omega) + np.cross(P, v) + np.cross(first, G * down)
    return np.concatenate([force, moment + to_body @ flow[3:]])


def solve_spiral(battery, heavy_kg, start=(0.49, 0.022, -0.022, -0.62, -0.24, 0.004)):
    """V, alpha, beta, pitch, roll and turn of a steady spiral, by root-finding."""
    end, _, is_solved, _ = fsolve(
        spiral_rest, start, args=(battery, heavy_kg), full_output=True, xtol=1e-12
    )
    assert is_solved == 1
    return end


@pytest.fixture(scope="module")
def glider(x64):
    return params.build_vehicle(library.load_vehicle("seawing"), None, 16.0)


def step_freely(carry, settled, vehicle, engine, body, dt, water):
    current = (Uniform(velocity_mps=jnp.zeros(3)),)
    return physics.step(engine, body, vehicle, carry, settled, current, jnp.zeros(()), dt, water)


def run(engine, dt, water, vehicle, body, start, settled, count):
    """State before and after so many steps."""
    current = (Uniform(velocity_mps=jnp.zeros(3)),)
    first = physics.start_multistep(engine, body, vehicle, start, current, jnp.zeros(()), water)

    def one(_, state):
        return step_freely(state, settled, vehicle, engine, body, dt, water)

    return jax.lax.fori_loop(0, count, one, first)


@cache
def closed_program(dt, water):
    """Program of `run` in closed form; the vehicle is an argument."""
    return jax.jit(partial(run, CLOSED, dt, water))


def at_rest(**changes):
    """A vehicle with three actuators at rest, deep down."""
    state = physics.VehicleState(
        p=jnp.array([0.0, 0.0, -500.0]),
        q=jnp.array([1.0, 0.0, 0.0, 0.0]),
        nu=jnp.zeros(6),
        force_before=jnp.zeros(6),
        thrust=jnp.zeros(3),
    )
    return replace(state, **{name: jnp.asarray(x, float) for name, x in changes.items()})


def swim(vehicle, settled, seconds, *, engine=CLOSED, body=None, dt=0.02, water=SEA, **start):
    """State after so many seconds with settled values [3]."""
    numbers = at_rest(**start), jnp.asarray(settled, float), jnp.asarray(round(seconds / dt))
    if body is None:
        return closed_program(dt, water)(vehicle, vehicle, *numbers)
    return jax.jit(partial(run, engine, dt, water))(vehicle, body, *numbers)


def attitude(q):
    """Pitch (bow up) and roll (right side down) of a quaternion wxyz of F to W."""
    yaw, pitch, roll = Rotation.from_quat(np.asarray(q), scalar_first=True).as_euler("ZYX")
    del yaw
    return -pitch, roll


def test_the_papers_spiral_by_its_equations():
    """These signs of the table give the spiral that the paper prints, turned by 45 degrees."""
    battery = np.array([0.4216, -OFFSET_M * np.sin(np.pi / 4), OFFSET_M * np.cos(np.pi / 4)])
    end = solve_spiral(battery, 0.3)
    published = [0.490, *np.radians([1.267, -1.283, -35.641, -13.703]), 0.0039]
    np.testing.assert_allclose(end, published, rtol=0.02)


@pytest.mark.parametrize("heavy_kg", [0.3, -0.3])
def test_steady_glides_are_those_of_the_papers_forces(glider, heavy_kg):
    """Speed, angle of attack and pitch, down and up, against roots of the paper's equations."""
    moved = np.copysign(0.02, heavy_kg)
    sign = np.sign(heavy_kg)
    start = (0.47, sign * 0.025, 0.0, -sign * 0.58, 0.0, 0.0)
    battery = np.array([MIDDLE_M + moved, 0.0, OFFSET_M])
    speed, alpha, beta, pitch, roll, turn = solve_spiral(battery, heavy_kg, start)
    settled = [heavy_kg / 1025.0, moved, 0.0]
    end = swim(glider, settled, 600.0, thrust=settled)
    nu = np.asarray(end.nu)
    assert np.linalg.norm(nu[:3]) == pytest.approx(speed, rel=2e-3)
    assert np.arctan2(-nu[2], nu[0]) == pytest.approx(alpha, rel=0.02)
    assert attitude(end.q)[0] == pytest.approx(pitch, rel=2e-3)
    np.testing.assert_allclose([beta, roll, turn, *nu[[1, 3, 5]]], 0.0, atol=1e-9)
    # Its file knows the same glide.
    config = library.load_vehicle("seawing")
    known = glide.solve_glide(config, config.find_set(None), settled[0], pitch)
    assert np.linalg.norm(known.velocity_mps) == pytest.approx(speed, rel=2e-3)
    assert known.mass_m == pytest.approx(moved, rel=0.02)


def test_a_battery_to_the_side_turns_it_as_in_the_papers_equations(glider):
    """At the speed at which damping of rates is taken; the turn is a difference of moments."""
    side, heavy_kg = 0.01, 0.335
    battery = np.array([MIDDLE_M + 0.02, -side, OFFSET_M])
    speed, _, beta, pitch, roll, turn = solve_spiral(battery, heavy_kg)
    settled = [heavy_kg / 1025.0, 0.02, side]
    end = swim(glider, settled, 1500.0, thrust=settled)
    nu = np.asarray(end.nu)
    assert speed == pytest.approx(0.49, abs=0.01)
    assert np.linalg.norm(nu[:3]) == pytest.approx(speed, rel=2e-3)
    assert np.arcsin(-nu[1] / speed) == pytest.approx(beta, rel=0.03)
    np.testing.assert_allclose(attitude(end.q), (pitch, roll), rtol=0.03)
    assert -np.sign(nu[5]) * np.linalg.norm(nu[3:]) == pytest.approx(turn, rel=0.05)


def test_neutral_trim_pitch_is_that_of_the_centre_of_gravity(glider):
    """At rest the centre of gravity hangs below that of buoyancy: tan(pitch) = -m_k s / (m z_b)."""
    for moved, side in ((0.01, 0.0), (-0.015, 0.004)):
        end = swim(glider, [0.0, moved, side], 4000.0, dt=0.05, thrust=[0.0, moved, side])
        first = HULL_KG * HULL_M + BATTERY_KG * np.array([MIDDLE_M + moved, -side, OFFSET_M])
        pitch = np.arctan2(-first[0], np.hypot(first[1], first[2]))
        roll = np.arctan2(-first[1], first[2])
        assert attitude(end.q)[0] == pytest.approx(pitch, rel=1e-3)
        assert attitude(end.q)[1] == pytest.approx(-roll, rel=1e-3, abs=1e-9)
        assert np.abs(np.asarray(end.nu[3:])).max() < 1e-6


def test_terminal_speeds_of_ballast_alone(glider):
    """Held level, weight of the water against linear and quadratic drag of heave."""
    held = replace(
        glider,
        cross_damping=None,
        D_l=jnp.array([1e6, 1e6, 0.5, 1e6, 1e6, 1e6]),
        D_q=glider.D_q,
    )
    for litres in (0.4, -0.2):
        settled = [litres * 1e-3, 0.0, 0.0]
        weight = litres * 1.025 * G
        end = swim(held, settled, 300.0, thrust=settled)
        w = (-0.5 + np.sqrt(0.25 + 4.0 * 50.0 * abs(weight))) / 100.0
        assert float(end.nu[2]) == pytest.approx(-np.sign(litres) * w, rel=1e-4)


def test_servos_hold_rates_and_limits(glider):
    full = [5e-4, 0.05, -0.014]
    soon = swim(glider, full, 3.0)
    np.testing.assert_allclose(soon.thrust, [3 * 4e-5, 3 * 0.004, -3 * 0.002], rtol=1e-6)
    late = swim(glider, full, 60.0)
    np.testing.assert_allclose(late.thrust, full, rtol=1e-6)
    settled = trim.settled_trim(glider.trim, jnp.array([2500.0, 1900.0, 900.0]))
    np.testing.assert_allclose(settled, full)
    signals = trim.trim_signals(glider.trim, jnp.array([1.0, 0.025, -0.014]))
    np.testing.assert_allclose(signals, [1900.0, 1700.0, 1100.0])


def test_energy_of_a_stroke_is_power_by_way_over_rate(glider):
    """However fast it is commanded: sums of the power over a stroke of 0.5 l at 40 W, 40 ml/s."""
    settled, values, total = jnp.array([5e-4, 0.0, 0.0]), jnp.zeros(3), 0.0
    for _ in range(4000):
        total += 0.01 * float(trim.trim_power_w(glider.trim, values, settled))
        change = (settled - values) * (1 - np.exp(-0.01 / glider.trim.tau_s))
        values = values + jnp.clip(change, -glider.trim.rate * 0.01, glider.trim.rate * 0.01)
    assert total == pytest.approx(40.0 * 5e-4 / 4e-5, rel=0.01)


def test_energy_without_drag_is_that_of_the_whole_mass(glider):
    """In a vacuum of drag and added mass the glider with moved masses keeps its energy."""
    free = replace(
        glider,
        M_A=jnp.zeros((6, 6)),
        D_l=jnp.zeros(6),
        D_q=jnp.zeros(6),
        cross_damping=None,
    )
    settled = [3e-4, 0.04, 0.01]

    def energy(state):
        nu, up = np.asarray(state.nu), Rotation.from_quat(np.asarray(state.q), scalar_first=True)
        dry = np.zeros((6, 6))
        dry[:3, :3], dry[3:, 3:] = 65.28 * np.eye(3), np.asarray(glider.inertia_kgm2)
        # Water in the tank, and the two rows of the battery, as points.
        points = [(0.3075, [0.0, 0.0, 0.00502])]
        middle = np.array([MIDDLE_M, 0.0, -0.014 + 0.00502])
        for moved in ([0.04, 0.0, 0.0], [0.0, 0.01, 0.0]):
            points += [(BATTERY_KG, middle + moved), (-BATTERY_KG, middle)]
        first = np.zeros(3)
        for mass, at in points:
            x, y, z = at
            lever = np.array([[0, z, -y], [-z, 0, x], [y, -x, 0.0]])
            dry += mass * np.block([[np.eye(3), lever], [lever.T, lever.T @ lever]])
            first = first + mass * np.asarray(at)
        height = 0.3075 * float(state.p[2]) + float(up.apply(first)[2])
        buoyancy = float(glider.volume_m3) * 1025.0 - 65.28
        lifted = float(up.apply(np.asarray(glider.p_cb_m))[2])
        return 0.5 * nu @ dry @ nu + G * (
            height - buoyancy * float(state.p[2]) - float(glider.volume_m3) * 1025.0 * lifted
        )

    start = {"nu": [0.3, 0.05, -0.1, 0.2, 0.1, -0.15], "thrust": settled}
    drift, moving = [], 0.5 * 65.28 * (0.3**2 + 0.05**2 + 0.1**2)
    for dt in (0.02, 0.01):
        before = energy(at_rest(**start))
        after = energy(swim(free, settled, 20.0, dt=dt, **start))
        drift.append(abs(after - before))
    assert drift[1] < 1e-3 * moving
    assert drift[0] / drift[1] > 3.0


def test_the_reaction_to_a_moving_battery_is_within_its_bound(glider):
    """Against the motion ahead with both bodies, held level: M u' = -X(u) - m s''.

    Left out here; the bound of the speed is m r / M, of the way m s / M.
    """
    rate, lag, stop = 0.004, 0.5, 0.04
    total, drag = 65.28 + 1.48, 7.19

    def acceleration(t):
        until = stop / rate - lag
        return 0.0 if t < until else -rate / lag * np.exp(-(t - until) / lag)

    # The start is a blow: from rest to the fastest rate.
    exact = solve_ivp(
        lambda t, x: [x[1], -(drag * abs(x[1]) * x[1] + BATTERY_KG * acceleration(t)) / total],
        (0.0, 20.0),
        [0.0, -BATTERY_KG * rate / total],
        max_step=0.02,
        rtol=1e-8,
        atol=1e-10,
    )
    held = replace(glider, D_l=jnp.full(6, 1e8).at[0].set(0.0), cross_damping=None)
    ours = swim(held, [0.0, stop, 0.0], 20.0)
    assert float(ours.thrust[1]) == pytest.approx(stop, rel=1e-6)
    assert np.abs(exact.y[1] - float(ours.nu[0])).max() <= 1.001 * BATTERY_KG * rate / total
    way_m = abs(exact.y[0, -1] - float(ours.p[0]))
    assert 0.9 * BATTERY_KG * stop / total < way_m <= 1.001 * BATTERY_KG * stop / total


def test_engines_agree(glider):
    config = library.load_vehicle("seawing")
    engine, body = mjx_engine.build_engine([mjcf.to_spec(config, None, shapes=False)])
    body = jax.tree.map(lambda leaf: leaf[0], body)
    settled = [4e-4, 0.03, -0.01]
    ends = [
        swim(glider, settled, 5.0, engine=chosen, body=inertia, nu=[0.3, 0, 0, 0.1, 0.05, -0.1])
        for chosen, inertia in ((CLOSED, None), (engine, body))
    ]
    for name in ("p", "q", "nu"):
        np.testing.assert_allclose(
            getattr(ends[0], name), getattr(ends[1], name), rtol=1e-8, atol=1e-9
        )
