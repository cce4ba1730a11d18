"""Way-points are followed along their lines, through currents, and the last one is held."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws import ismc, los

from ....compiling import quickly

DT, SPEED = 0.05, 0.4
POINTS = np.array([[0, 0, 0], [3, 0, 0], [3, 2, -1], [3, 2, -3], [0.5, 2, -3.0]])


@pytest.fixture(scope="module")
def flights(pool):
    lengths = np.linalg.norm(np.diff(POINTS, axis=0), axis=1)
    time = np.concatenate([[0], np.cumsum(lengths / SPEED)])
    # Two rows of padding.
    path = Trajectory(
        time_s=jnp.asarray(np.append(time, time[-1:].repeat(2))),
        position_m=jnp.asarray(pool.deep + np.vstack([POINTS, POINTS[-1:].repeat(2, axis=0)])),
        found=jnp.asarray(True),
    )

    def control(gains, vehicle, carry, at, target, flow):
        above, twist = los.step(gains[0], vehicle, carry[0], at, path, DT, 1000.0, 9.81)
        below, wrench = ismc.step(gains[1], vehicle, carry[1], at, twist, DT, 1000.0, 9.81)
        return (above, below), wrench

    gains = (los.LosGains(), ismc.IsmcGains())
    guided = pool.Controller(lambda at: (los.reset(at), ismc.reset(at)), control, gains)
    return pool.fly({"los": guided}, {"los": pool.Variant("los")})["los"]


def off_path(p):
    """Distance of points [..., 3] from the broken line."""
    found = np.full(p.shape[:-1], np.inf)
    for a, b in itertools.pairwise(POINTS):
        share = np.clip((p - a) @ (b - a) / ((b - a) @ (b - a)), 0, 1)
        found = np.minimum(found, np.linalg.norm(p - a - share[..., None] * (b - a), axis=-1))
    return found


def test_the_path_is_followed_and_its_end_held(flights, pool):
    p = flights.p[:, pool.STEP] - pool.deep
    # Corners are cut from 0.3 m before the way-point: 0.3 / sqrt 2 at most, where it turns by 90.
    assert off_path(p).max() < 0.22
    # 9.6 m at 0.4 m/s are done in 24 s, and the end comes nearer by 0.8 a second.
    assert np.linalg.norm(p[:, -1] - POINTS[-1], axis=-1).max() < 0.05
    # On the way it goes at the speed that was planned: 3 s to 6 s of the first leg.
    speed = np.linalg.norm(np.diff(p, axis=1), axis=-1)[:, 60:120] / DT
    assert np.abs(speed - SPEED).max() < 0.02


def test_all_way_points_are_passed_in_order(flights, pool):
    p = flights.p[:, pool.STEP] - pool.deep
    for row in p:
        nearest = [np.linalg.norm(row - point, axis=-1).argmin() for point in POINTS]
        assert nearest == sorted(nearest)


def test_a_current_does_not_push_it_off_the_line(flights, pool):
    """0.5 m/s at 40 degrees, unknown: the velocity loop and the integral of the guidance hold."""
    p = flights.p[:, pool.CURRENT] - pool.deep
    able = [i for i, kind in enumerate(pool.kinds) if kind[1] != "von_benzon2022"]
    # The start from rest costs 0.2 m; then as in still water. von_benzon2022 has 0.77 m/s in sway,
    # which 0.5 m/s of current and 0.4 m/s of speed over ground are more than.
    assert off_path(p[able]).max() < 0.3
    assert off_path(p[able][:, 60:]).max() < 0.25
    assert np.linalg.norm(p[able][:, -1] - POINTS[-1], axis=-1).max() < 0.05


def test_the_nose_follows_the_course(flights, pool):
    w, x, y, z = np.moveaxis(flights.q[:, pool.STEP], -1, 0)
    yaw = np.degrees(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))
    # East along the first leg; then north, and on the vertical leg as before.
    assert np.abs(yaw[:, 40:100]).max() < 5
    p = flights.p[:, pool.STEP] - pool.deep
    diving = (p[..., 2] < -1.6) & (p[..., 2] > -2.6)
    assert np.all(np.abs(yaw[diving] - 90) < 12)


def test_a_path_of_one_point_is_held(robots, states):
    vehicles, _ = robots
    estimate, _ = states
    vehicle, at = jax.tree.map(lambda x: x[0], (vehicles, estimate))
    path = Trajectory(
        time_s=jnp.zeros(2), position_m=jnp.stack([at.p, at.p]), found=jnp.asarray(False)
    )
    _, twist = los.step(los.LosGains(), vehicle, los.reset(at), at, path, DT, 1000.0, 9.81)
    # Rounding of 10 m in float32.
    assert np.abs(twist.nu[:3]).max() < 1e-4


def test_a_leg_of_less_than_a_second_has_its_speed_too(robots):
    vehicle = jax.tree.map(lambda x: x[0], robots[0])
    path = Trajectory(
        time_s=jnp.array([0.0, 0.8, 8.8]),
        position_m=jnp.array([[0.0, 0.0, -5.0], [0.24, 0.0, -5.0], [0.24, 4.0, -5.0]]),
        found=jnp.asarray(True),
    )
    at = Estimate(p=path.position_m[0], q=jnp.array([1.0, 0, 0, 0]), nu=jnp.zeros(6))
    gains = los.LosGains(switch_radius_m=0.1)
    _, twist = los.step(gains, vehicle, los.reset(at), at, path, DT, 1000.0, 9.81)
    # 0.24 m in 0.8 s, straight ahead; float32.
    np.testing.assert_allclose(twist.nu, [0.3, 0, 0, 0, 0, 0], atol=1e-6)


def test_the_integral_steers_against_a_drift_that_nobody_holds(robots, pool):
    """A point that does what it is told plus 0.1 m/s sideways, on a long line."""
    vehicle = jax.tree.map(lambda x: x[0], robots[0])
    level = jnp.array([1.0, 0.0, 0.0, 0.0])
    path = Trajectory(
        time_s=jnp.array([0.0, 500.0]),
        position_m=jnp.asarray(pool.deep + np.array([[0.0, 0, 0], [200.0, 0, 0]])),
        found=jnp.asarray(True),
    )
    drift = jnp.array([0.0, 0.06, 0.08])

    def run(gains):
        def one(pair, _):
            p, carry = pair
            at = Estimate(p=p, q=level, nu=jnp.zeros(6))
            carry, twist = los.step(gains, vehicle, carry, at, path, DT, 1000.0, 9.81)
            return (p + DT * (twist.nu[:3] + drift), carry), p - pool.deep

        start = jnp.asarray(pool.deep)
        at = Estimate(p=start, q=level, nu=jnp.zeros(6))
        return jax.lax.scan(one, (start, los.reset(at)), length=4000)[1]

    weights = los.LosGains(lookahead_m=0.8, integral_per_s=jnp.array([0.0, 0.1]))
    axes = los.LosGains(**{name: None for name in vars(weights)} | {"integral_per_s": 0})
    plain, integral = np.asarray(quickly(jax.vmap(run, (axes,)))(weights))
    # Plain: 0.4 e / sqrt(e^2 + 0.8^2) = 0.1, so e = 0.8 / sqrt 15, split as the drift.
    np.testing.assert_allclose(plain[-1, 1:], 0.8 / np.sqrt(15) * np.array([0.6, 0.8]), rtol=0.01)
    # With it: an error of e is worth sigma e / D of pull a second; 200 s are enough for 1 cm.
    assert np.abs(integral[-1, 1:]).max() < 0.01
