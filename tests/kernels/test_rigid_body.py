"""Terms of the equation of motion, one by one, for bodies with full matrices."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from angler_kernels import rigid_body

from ..angler_mjx.compiling import quickly

N = 40

advance_damped_velocity = quickly(rigid_body.advance_damped_velocity)
advance_poses = quickly(jax.vmap(rigid_body.advance_pose, (0, 0, 0, 0, None)))


@pytest.fixture(scope="module", autouse=True)
def x64():
    with jax.enable_x64(True):
        yield


@pytest.fixture
def rng():
    """Of each test its own: what is found must not depend on which others run."""
    return np.random.default_rng(0)


def spd(rng, n):
    half = rng.normal(size=(N, n, n))
    return half @ half.swapaxes(1, 2) + 0.1 * np.eye(n)


def S(a):
    return np.array([[0, -a[2], a[1]], [a[2], 0, -a[0]], [-a[1], a[0], 0]])


def random_quaternions(rng):
    q = rng.normal(size=(N, 4))
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def matrices(q):
    return Rotation.from_quat(q, scalar_first=True).as_matrix()


# float64 rounding on sums of products of order 10, in the comparisons that use it.
NEAR = {"rtol": 1e-12, "atol": 1e-12}


def test_coriolis_forces_do_no_work(rng, deviation):
    M_A, inertia, nu = spd(rng, 6), spd(rng, 3), rng.normal(size=(N, 6))
    mass = rng.uniform(1, 20, N)
    added = np.asarray(jax.vmap(rigid_body.added_mass_coriolis)(M_A, nu))
    dry = np.asarray(jax.vmap(rigid_body.rigid_body_coriolis)(mass, inertia, nu))
    for force in (added, dry):
        deviation.close("coriolis.work", np.sum(nu * force, axis=1), 0, atol=1e-12)


def test_added_mass_coriolis_is_fossens_matrix(rng, deviation):
    M_A, nu = spd(rng, 6), rng.normal(size=(N, 6))
    ours = jax.vmap(rigid_body.added_mass_coriolis)(M_A, nu)
    for i in range(N):
        a, b = M_A[i, :3] @ nu[i], M_A[i, 3:] @ nu[i]
        C_A = np.block([[np.zeros((3, 3)), -S(a)], [-S(a), -S(b)]])
        deviation.close("coriolis.added_mass", ours[i], C_A @ nu[i], **NEAR)


def test_rigid_body_coriolis_is_newton_and_euler(rng, deviation):
    inertia, nu, mass = spd(rng, 3), rng.normal(size=(N, 6)), rng.uniform(1, 20, N)
    ours = jax.vmap(rigid_body.rigid_body_coriolis)(mass, inertia, nu)
    for i in range(N):
        v, w = nu[i, :3], nu[i, 3:]
        expected = np.concatenate([mass[i] * S(w) @ v, S(w) @ inertia[i] @ w])
        deviation.close("coriolis.rigid_body", ours[i], expected, **NEAR)


def test_damping_takes_power_and_its_slope_is_its_derivative(rng, deviation):
    D_l, D_q, nu = *rng.uniform(0, 10, (2, N, 6)), rng.normal(size=(N, 6))
    wrench = np.asarray(jax.vmap(rigid_body.damping_wrench)(D_l, D_q, nu))
    assert np.all(wrench * nu <= 0)
    exact = jax.vmap(jax.jacfwd(rigid_body.damping_wrench, argnums=2))(D_l, D_q, nu)
    slope = jax.vmap(rigid_body.damping_slope)(D_l, D_q, nu)
    written = np.asarray(slope)[:, :, None] * np.eye(6)
    deviation.close("damping.slope", -exact, written, **NEAR)


def test_submerged_fraction_fades_over_the_hull():
    z = jnp.array([-5.0, -0.15, 0.0, 0.075, 0.15, 2.0])
    share = rigid_body.submerged_fraction(z, jnp.float64(0.3))
    np.testing.assert_allclose(share, [1, 1, 0.5, 0.25, 0, 0], **NEAR)


def test_buoyancy_rights_the_body(rng, deviation):
    q, arm = random_quaternions(rng), rng.normal(size=(N, 3))
    lift = rng.uniform(1, 100, N)
    ours = jax.vmap(rigid_body.buoyancy_wrench)(q, lift, arm)
    force = np.einsum("nji,j->ni", matrices(q), [0, 0, 1.0]) * lift[:, None]
    expected = np.concatenate([force, np.cross(arm, force)], axis=1)
    deviation.close("buoyancy.wrench", ours, expected, rtol=1e-12, atol=1e-11)


def water_of(M_A, q, nu, v_c, Dv_c, *, z=-9.0, gravity=0.0):
    return jax.vmap(
        lambda M_A, q, nu, v_c, Dv_c: rigid_body.water_wrench(
            M_A=M_A,
            D_l=jnp.array([4.0, 6, 5, 0.1, 0.2, 0.3]),
            D_q=jnp.array([18.0, 21, 36, 1, 2, 3]),
            volume=jnp.float64(0.012),
            p_cb=jnp.array([0.01, -0.02, 0.03]),
            height=jnp.float64(0.3),
            z=jnp.float64(z),
            q=q,
            nu=nu,
            v_c=v_c,
            Dv_c=Dv_c,
            density=1000.0,
            gravity=gravity,
        )
    )(M_A, q, nu, v_c, Dv_c)


def test_a_steady_uniform_current_changes_nothing_but_the_frame(rng, deviation):
    """Seen by someone who drifts along, motion in a uniform current is motion in still water."""
    M_A, q, nu, v_c = (
        spd(rng, 6),
        random_quaternions(rng),
        rng.normal(size=(N, 6)),
        rng.normal(size=(N, 3)),
    )
    mass, inertia = 12.0, np.diag([0.2, 0.3, 0.4])
    body_v_c = np.einsum("nji,nj->ni", matrices(q), v_c)
    nu_c = np.concatenate([body_v_c, np.zeros((N, 3))], axis=1)
    M = M_A + np.diag([mass] * 3 + [0.2, 0.3, 0.4])

    def nu_dot(nu, v_c):
        water = water_of(M_A, q, nu, v_c, np.zeros((N, 3)))
        rigid = jax.vmap(rigid_body.rigid_body_coriolis, (None, None, 0))(mass, inertia, nu)
        return np.linalg.solve(M, np.asarray(water - rigid)[..., None])[..., 0]

    still = nu_dot(nu - nu_c, np.zeros((N, 3)))
    carried = nu_dot(nu, v_c)
    turn = np.concatenate([np.cross(nu[:, 3:], body_v_c), np.zeros((N, 3))], axis=1)
    deviation.close("current.frame", carried, still - turn, rtol=1e-10, atol=1e-10)


def test_a_neutral_body_that_moves_with_the_water_is_accelerated_with_it(rng, deviation):
    """Without slip and spin, nu' = Dv_c/Dt whatever the added mass: the body is water itself."""
    M_A, q = spd(rng, 6), random_quaternions(rng)
    M_A[:, :3, 3:] = M_A[:, 3:, :3] = 0
    v_c, Dv_c = rng.normal(size=(2, N, 3))
    to_body = matrices(q).swapaxes(1, 2)
    carried = np.einsum("nij,nj->ni", to_body, v_c)
    nu = np.concatenate([carried, np.zeros((N, 3))], axis=1)
    wrench = np.asarray(water_of(M_A, q, nu, v_c, Dv_c))
    M = M_A[:, :3, :3] + 12.0 * np.eye(3)
    expected = np.einsum("nij,nj->ni", to_body, Dv_c)
    ours = np.linalg.solve(M, wrench[:, :3, None])[..., 0]
    deviation.close("current.carried", ours, expected, rtol=1e-11, atol=1e-11)


def test_out_of_the_water_there_is_neither_lift_nor_pressure(rng):
    zero, q = np.zeros((N, 3)), random_quaternions(rng)
    M_A = np.zeros((N, 6, 6))
    above = water_of(M_A, q, np.zeros((N, 6)), zero, np.ones((N, 3)), z=1.0, gravity=9.81)
    np.testing.assert_array_equal(above, 0)
    below = water_of(M_A, q, np.zeros((N, 6)), zero, zero, gravity=9.81)
    np.testing.assert_allclose(np.linalg.norm(below[:, :3], axis=1), 12 * 9.81, **NEAR)


def test_explicit_velocity_step_is_exact_for_a_linear_acceleration():
    a, b, dt = np.arange(6.0), np.linspace(1, -1, 6), 0.1
    nu = rigid_body.advance_velocity(jnp.zeros(6), a + b * 0.3, a + b * 0.2, dt)
    np.testing.assert_allclose(nu, a * dt + b * (0.4**2 - 0.3**2) / 2, **NEAR)


def test_damped_velocity_step(rng):
    M, nu, f, b = spd(rng, 6)[0], *rng.normal(size=(3, 6))
    D_l, dt, none = rng.uniform(0, 5, 6), 0.05, np.zeros(6)
    # Without damping it is the explicit formula.
    g = rng.normal(size=6)
    step = rigid_body.advance_damped_velocity
    free, memory = step(nu, nu, M, none, none, f, g, b, dt)
    a, before, held = (np.linalg.solve(M, x) for x in (f, g, b))
    explicit = rigid_body.advance_velocity(nu, a, before, dt) + dt * held
    np.testing.assert_allclose(free, explicit, rtol=1e-10)
    np.testing.assert_array_equal(memory, f)
    # With linear damping alone it is the trapezoidal rule, at the first step and at every later.
    f = -D_l * nu
    first, memory = step(nu, nu, M, D_l, none, f, f, b, dt)
    J = np.diag(D_l)
    rule = np.linalg.solve(M + dt / 2 * J, (M - dt / 2 * J) @ nu + dt * b)
    np.testing.assert_allclose(first, rule, rtol=1e-10)
    np.testing.assert_allclose(memory, -D_l * first, rtol=1e-10, atol=1e-12)


def test_quadratic_damping_is_of_second_order_and_never_grows():
    D_q, m = jnp.geomspace(0.1, 1e6, 6), 2.0

    def run(dt, seconds):
        nu = jnp.ones(6)
        memory, speeds = -D_q * nu * nu, [nu]
        for _ in range(round(seconds / dt)):
            force = -D_q * jnp.abs(nu) * nu
            nu, memory = advance_damped_velocity(
                nu, nu, m * jnp.eye(6), 0 * D_q, D_q, force, memory, 0 * nu, dt
            )
            speeds.append(nu)
        return np.abs(np.array(speeds))

    # Up to 5e5 times beyond what an explicit step can take.
    assert np.all(np.diff(run(0.5, 20), axis=0) <= 0)
    # 1 / nu grows by D_q t / m; the mild ones, 2.5 and 0.1, converge with four times less at half.
    exact = 1 / (1 + D_q[:2] / m)
    coarse, fine = (np.abs(run(dt, 1.0)[-1][:2] - exact) for dt in (0.1, 0.05))
    np.testing.assert_allclose(coarse / fine, 4, rtol=0.15)  # room for the next order


def test_linear_damping_never_grows():
    nu, D_l = jnp.ones(6), 1e6 * jnp.ones(6)
    memory = -D_l * nu
    for _ in range(50):
        # A million times beyond what an explicit step can take.
        nu, memory = advance_damped_velocity(
            nu, nu, jnp.eye(6), D_l, 0 * D_l, -D_l * nu, memory, 0 * nu, 1.0
        )
        assert np.all(np.abs(nu) <= 1 + 1e-9)  # Rounding of 1e6.


def test_pose_step_follows_the_helix(rng, deviation):
    """A constant body velocity is a screw motion; the attitude is exact, the position O(dt^3)."""
    q0, nu = random_quaternions(rng), rng.normal(size=(N, 6))

    def run(dt):
        p, q = jnp.zeros((N, 3)), jnp.asarray(q0)
        for _ in range(round(1 / dt)):
            p, q = advance_poses(p, q, nu, nu, dt)
        return np.asarray(p), np.asarray(q)

    turn = Rotation.from_rotvec(nu[:, 3:])
    R0 = Rotation.from_quat(q0, scalar_first=True)
    angle = np.linalg.norm(nu[:, 3:], axis=1)[:, None]
    axis = nu[:, 3:] / angle
    v = nu[:, :3]
    across = np.cross(axis, v)
    along = np.sum(axis * v, axis=1, keepdims=True) * axis
    rotated = along + np.sin(angle) / angle * (v - along) + (1 - np.cos(angle)) / angle * across
    exact = R0.apply(rotated)
    _, q = run(0.1)
    deviation.close("pose.attitude", matrices(q), (R0 * turn).as_matrix(), atol=1e-13)
    np.testing.assert_allclose(np.linalg.norm(q, axis=1), 1, atol=1e-15)
    coarse, fine = (np.abs(run(dt)[0] - exact).max() for dt in (0.1, 0.05))
    # Second order: four times less, with 5 % for the next order.
    deviation("pose.order", abs(coarse / fine - 4), 0.2)
