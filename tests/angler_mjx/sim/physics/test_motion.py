"""Motion with a known outcome: terminal speed, decay, drift with a current, orbit in a vortex."""

from dataclasses import replace
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

from angler_kernels import rigid_body
from angler_mjx.sim.physics import step as physics
from angler_mjx.world.currents import Uniform, Vortices

from ...compiling import quickly
from . import plants as plant_module
from .plants import WATER

DT = 0.01
# Drag of a sphere of 0.1 m radius, along each body axis, and a vortex with 0.25 m/s at its edge.
DRAG, CIRCULATION = 0.5 * 1000 * 0.47 * 0.0337, 2.5
LEVEL = [1.0, 0, 0, 0]
REST = [0.0] * 6


@pytest.fixture(scope="module")
def simple(plants):
    """The shipped variants: diagonal matrices, so that single axes have closed forms.

    The last of the plants, whose matrices are full, flies along and is not looked at.
    """
    return replace(
        plants,
        names=plants.names[:-1],
        params=jax.tree.map(lambda leaf: leaf[:-1], plants.params),
    )


def neutral(vehicles):
    return replace(vehicles, volume_m3=vehicles.mass_kg / WATER.density_kgpm3)


def inertia(plants, axis):
    added = np.asarray(plants.params.M_A)[:, axis, axis]
    if axis < 3:
        return np.asarray(plants.params.mass_kg) + added
    return np.asarray(plants.params.inertia_kgm2)[:, axis - 3, axis - 3] + added


def fly(plants, vehicles, *, nu=REST, q=LEVEL, thrust=0.0, flow=(0.0, 0.0, 0.0)):
    """[n, 100] states every 0.1 s for 10 s."""
    vehicles = jax.tree.map(lambda leaf: jnp.concatenate([leaf, leaf[-1:]]), vehicles)
    n = len(plants) + 1
    state = plant_module.start(
        vehicles, np.tile([0.0, 0, -50], (n, 1)), np.tile(q, (n, 1)), np.tile(nu, (n, 1))
    )
    commands = np.zeros((n, 100, vehicles.B.shape[-1]))
    commands[:-1] = thrust
    current = (Uniform(velocity_mps=jnp.asarray(flow)), plant_module.still()[1])
    after = plant_module.rollout(
        plants.engine, plants.body, vehicles, state, commands, current, dt=DT
    )
    return jax.tree.map(lambda leaf: leaf[:-1], after)


def decay(v0, t, m, D_l, D_q):
    """v(t) of m v' = -(D_l + D_q |v|) v, for v0 > 0."""
    k = D_l / m
    # (1 - exp(-k t)) / D_l, which is t / m without linear damping.
    share = np.where(D_l > 0, -np.expm1(-k * t) / np.where(D_l > 0, D_l, 1), t / m)
    return v0 * np.exp(-k * t) / (1 + D_q * v0 * share)


TIMES = 0.1 * np.arange(1, 101)


@pytest.mark.parametrize(("axis", "v0"), [(2, 0.8), (5, 1.2)], ids=["heave", "yaw"])
def test_free_decay_has_its_closed_form(simple, axis, v0, deviation):
    nu = np.zeros(6)
    nu[axis] = v0
    after = np.asarray(fly(simple, neutral(simple.params), nu=nu).nu)
    D_l, D_q = np.asarray(simple.params.D_l)[:, axis], np.asarray(simple.params.D_q)[:, axis]
    m = inertia(simple, axis)
    exact = decay(v0, TIMES, m[:, None], D_l[:, None], D_q[:, None])
    # The trapezoidal rule errs by (J dt / M)^2 / 12 of the speed lost meanwhile: J / M is 36 1/s
    # at most in yaw at the start (BlueROV2), 12 1/s in heave; it falls with the speed, and the
    # slower decay of too fast a speed makes most of the error up again.
    error = np.abs(after[:, :, axis] - exact)
    name = "heave" if axis == 2 else "yaw"
    deviation(f"decay.{name}", error, 1e-3 if axis == 2 else 3e-3)
    deviation(f"decay.{name}_after_1_s", error[:, 10:], 1e-4)
    rest = np.delete(after, axis, axis=2)
    # Nothing couples into the other axes; rounding.
    deviation("decay.other_axes", np.abs(rest), 1e-12)


def test_free_roll_is_the_pendulum_with_drag(simple, deviation):
    angle = 0.6
    q = [np.cos(angle / 2), np.sin(angle / 2), 0, 0]
    after = fly(simple, neutral(simple.params), q=q)
    w, x = np.asarray(after.q)[..., 0], np.asarray(after.q)[..., 1]
    roll = 2 * np.arctan2(x, w)
    lift = WATER.gravity_mps2 * np.asarray(simple.params.mass_kg)
    for i in range(len(simple)):
        m, z_cb = inertia(simple, 3)[i], float(simple.params.p_cb_m[i, 2])
        D_l, D_q = float(simple.params.D_l[i, 3]), float(simple.params.D_q[i, 3])

        def rate(_, y, m=m, k=lift[i] * z_cb, D_l=D_l, D_q=D_q):
            return [y[1], (-k * np.sin(y[0]) - (D_l + D_q * abs(y[1])) * y[1]) / m]

        exact = solve_ivp(
            rate, (0, 10), [angle, 0], "DOP853", t_eval=TIMES, rtol=1e-10, atol=1e-12
        ).y[0]
        # The pendulum's phase errs by (omega dt)^2 / 12 a radian, omega = 4 1/s at most and 30 rad
        # in 10 s: 4e-3 of the 0.6 rad without drag; with it the swing is gone before that.
        deviation.close("decay.roll", roll[i], exact, atol=5e-4, about=simple.names[i])


def test_terminal_speed_in_heave(simple, deviation):
    """Vertical thrusters down at 5 N each and the net buoyancy up, against damping."""
    vertical = np.asarray(simple.params.B)[:, 2] < -0.5
    thrust = 5.0 * vertical[:, None, :]
    w = np.asarray(fly(simple, simple.params, thrust=thrust).nu)[:, -1, 2]
    lift = WATER.density_kgpm3 * np.asarray(simple.params.volume_m3)
    force = WATER.gravity_mps2 * (lift - np.asarray(simple.params.mass_kg)) - 5 * vertical.sum(1)
    assert np.all(force < 0)
    D_l, D_q = np.asarray(simple.params.D_l)[:, 2], np.asarray(simple.params.D_q)[:, 2]
    exact = 2 * force / (D_l + np.sqrt(D_l**2 - 4 * D_q * force))
    # The difference dies out with J / M >= 1.4 1/s: e^-14 = 1e-6 is left after 10 s. A steady
    # state of the equation is one of the scheme, so no step size enters.
    deviation.close("terminal.heave", w, exact, rtol=5e-6)


def test_a_neutral_vehicle_takes_the_speed_of_a_uniform_current(simple, deviation):
    # Along one body axis, so that the slip has a closed form.
    for axis in (0, 1, 2):
        v_c = np.zeros(3)
        v_c[axis] = 0.3
        after = np.asarray(fly(simple, neutral(simple.params), flow=v_c).nu)
        D_l, D_q = np.asarray(simple.params.D_l)[:, axis], np.asarray(simple.params.D_q)[:, axis]
        m = inertia(simple, axis)
        slip = decay(0.3, TIMES, m[:, None], D_l[:, None], D_q[:, None])
        # (J dt / M)^2 / 12 as above, J / M = 6 1/s at most: 3e-4 of 0.3 m/s.
        deviation.close("current.slip", 0.3 - after[:, :, axis], slip, atol=1e-4)
        assert np.all(slip[:, -1] < 0.03)


def orbit(pressure, vehicle, engine, body, current, radius, seconds):
    """Path [k, 3] of one body that starts with the water at (radius, 0); one row a second.

    The same terms and step as `sim.physics.step`, with a share of the pressure-gradient force.
    """

    def step(carry, _):
        state = carry
        M, force, nu_r = physics.smooth_force(
            engine, body, vehicle, state, current, jnp.zeros(()), WATER
        )
        _, Dv_c = physics.currents.evaluate(current, state.p, jnp.zeros(()))
        force = force.at[:3].add(-(1 - pressure) * vehicle.mass_kg * Dv_c)
        nu, before = rigid_body.advance_damped_velocity(
            state.nu,
            nu_r,
            M,
            vehicle.D_l,
            vehicle.D_q,
            force,
            state.force_before,
            jnp.zeros(6),
            DT,
        )
        p, q = rigid_body.advance_pose(state.p, state.q, state.nu, nu, DT)
        return replace(state, p=p, q=q, nu=nu, force_before=before), None

    def second(state, _):
        state, _ = jax.lax.scan(step, state, length=round(1 / DT))
        return state, state.p

    p = jnp.array([radius, 0.0, -50.0])
    v_c = physics.currents.velocity(current, p, jnp.zeros(()))
    state = physics.VehicleState(
        p=p,
        q=jnp.array(LEVEL),
        nu=jnp.concatenate([v_c, jnp.zeros(3)]),
        force_before=jnp.zeros(6),
        thrust=jnp.zeros(vehicle.B.shape[-1]),
    )
    state = physics.start_multistep(engine, body, vehicle, state, current, jnp.zeros(()), WATER)
    return jax.lax.scan(second, state, length=seconds)[1]


@pytest.mark.nightly(by="physics/test_textbook.py")
def test_a_neutral_sphere_keeps_its_orbit_in_a_vortex(simple, deviation):
    """With the pressure-gradient force it is a particle of water; without, it spirals out."""
    first = plant_module.pick(simple.params, 0)
    added = 0.5 * first.mass_kg  # A sphere's added mass is half the water that it displaces.
    vehicle = replace(
        first,
        volume_m3=first.mass_kg / WATER.density_kgpm3,
        M_A=jnp.diag(jnp.array([1.0, 1, 1, 0, 0, 0]) * added),
        D_l=jnp.zeros(6),
        D_q=jnp.zeros(6).at[:3].set(DRAG),
    )
    current = (
        Vortices(
            centre_m=jnp.zeros((1, 2)),
            circulation_m2ps=jnp.array([CIRCULATION]),
            core_m=jnp.array([1.0]),
        ),
    )
    run = quickly(jax.vmap(partial(orbit, radius=2.0, seconds=60), (0, *[None] * 4)))
    body = plant_module.pick(simple.body, 0)
    paths = np.asarray(run(jnp.array([1.0, 0.0]), vehicle, simple.engine, body, current))
    radii = np.hypot(paths[..., 0], paths[..., 1])
    # Second order at 10 ms: an angle of v dt / r = 2e-3 rad a step, squared, over 12 turns.
    deviation.close("vortex.orbit", radii[0], 2.0, atol=1e-3)
    # The known outcome without the force is "about 6 m"; an independent solution says exactly.
    deviation.close("vortex.spiral", radii[1], spiral(float(first.mass_kg), added), atol=1e-3)
    assert 5.5 < radii[1, -1] < 6.5


def spiral(mass, added):
    """Distance from the axis, every second, of the body without the pressure-gradient force."""

    def flow(x):
        square = x @ x
        return CIRCULATION / (2 * np.pi * square) * (1 - np.exp(-square)) * np.array([-x[1], x[0]])

    def rate(_, y):
        x, v = y[:2], y[2:]
        v_c = flow(x)
        speed = np.sqrt(v_c @ v_c)
        carried = -(speed**2) / (x @ x) * x  # The acceleration of water on a circle.
        slip = v - v_c
        return np.concatenate([v, (added * carried - DRAG * np.abs(slip) * slip) / (mass + added)])

    start = np.array([2.0, 0.0])
    solution = solve_ivp(
        rate,
        (0, 60),
        np.concatenate([start, flow(start)]),
        "DOP853",
        t_eval=np.arange(1, 61),
        rtol=1e-10,
        atol=1e-12,
    )
    return np.hypot(*solution.y[:2])
