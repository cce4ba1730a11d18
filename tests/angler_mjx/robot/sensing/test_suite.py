"""Instruments against closed forms: what they measure, when they speak, how they are wrong."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import ValidationError

from angler_kernels import lanes, quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.robot.sensing import instruments, params, suite
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.robot.sensing.readings import Truth

from ...compiling import quickly, thoroughly

DT = 0.05
N = 200
"""Steps that are watched where any number does, so that `watch` is compiled once."""
G = 9.81
ALL = {"usbl": {"fitted": True}, "gps": {"fitted": True}}
DEEP = (1.0, 2.0, -5.0)


def build(noise=True, dt=DT, **tables):
    return params.build_sensors(SensorsConfig.model_validate({"noise": noise, **tables}), dt, G)


def truth(p=DEEP, turn=(0.0, 0.0, 0.0), nu=(0.0,) * 6, altitude=5.0):
    q = quaternion.exp(jnp.asarray(turn, float))
    return Truth(
        p=jnp.asarray(p, float), q=q, nu=jnp.asarray(nu, float), altitude_m=jnp.asarray(altitude)
    )


def still(n=N, **kwargs):
    return jax.tree.map(lambda x: jnp.broadcast_to(x, (n, *x.shape)), truth(**kwargs))


def one_robot(sensors, truths, key):
    """Readings at every step, and the memory at the end.

    A loop in a loop: XLA copies all readings of a loop in each of its rounds.
    """

    def one(state, truth):
        k, carry = state
        carry, reading = suite.step(sensors, carry, key, k, truth)
        return (k + 1, carry), reading

    first = jax.tree.map(lambda x: x[0], truths)
    start = (jnp.zeros((), jnp.int32), suite.reset(sensors, key, first))
    parts = jax.tree.map(lambda x: x.reshape(-1, 40, *x.shape[1:]), truths)
    (_, carry), readings = jax.lax.scan(lambda *at: jax.lax.scan(one, *at), start, parts)
    return carry, jax.tree.map(lambda x: x.reshape(-1, *x.shape[2:]), readings)


watch = quickly(one_robot)
watch_many = thoroughly(jax.vmap(one_robot, (None, None, 0)))


def wander(n=N, seed=0):
    """A motion without any regularity."""
    sample = np.random.default_rng(seed).normal
    q = sample(size=(n, 4))
    q /= np.linalg.norm(q, axis=1, keepdims=True)
    p = sample(size=(n, 3)) * 3.0 - np.array([0.0, 0.0, 2.0])
    return jax.tree.map(
        lambda x: jnp.asarray(x, float),
        Truth(p=p, q=q, nu=sample(size=(n, 6)), altitude_m=np.full(n, 5.0)),
    )


def test_without_noise_readings_are_the_truth_bit_for_bit():
    truths = wander()
    upright = {"dvl": {"max_tilt_deg": 180.0}}
    _, seen = watch(build(noise=False, **ALL, **upright), truths, jax.random.key(0))
    truths, seen = jax.device_get((truths, seen))
    np.testing.assert_array_equal(seen.imu.rate_radps, truths.nu[:, 3:])
    for fresh, value, exact, every in (
        (seen.depth_fresh, seen.depth_m, -truths.p[:, 2], 2),
        (seen.ahrs_fresh, seen.ahrs_q, truths.q, 2),
        (seen.dvl_fresh, seen.dvl_velocity_mps, truths.nu[:, :3], 4),
    ):
        np.testing.assert_array_equal(np.flatnonzero(fresh), np.arange(0, 200, every))
        np.testing.assert_array_equal(value[fresh], exact[fresh])
        assert not value[~fresh].any()
    dry = seen.gps_fresh
    np.testing.assert_array_equal(
        np.flatnonzero(dry), [k for k in range(0, 200, 20) if truths.p[k, 2] >= -0.1]
    )
    assert 0 < dry.sum() < 10
    np.testing.assert_array_equal(seen.gps_position_m[dry], truths.p[dry, :2])


def test_without_noise_the_disturbed_truth_is_the_truth():
    exact = truth(turn=(0.1, 0.2, 0.3), nu=range(6))
    same = suite.disturb_truth(build(noise=False), jax.random.key(0), jnp.int32(7), exact)
    jax.tree.map(np.testing.assert_array_equal, same, exact)
    off = suite.disturb_truth(build(), jax.random.key(0), jnp.int32(7), exact)
    assert all(np.any(a != b) for a, b in ((off.p, exact.p), (off.q, exact.q), (off.nu, exact.nu)))


def test_usbl_fix_is_of_the_ping_and_comes_after_its_latency():
    truths = wander(seed=1)
    _, seen = watch(build(noise=False, **ALL), truths, jax.random.key(0))
    # 2 s and 0.5 s are 40 and 10 periods.
    np.testing.assert_array_equal(np.flatnonzero(seen.usbl_pinged), [0, 40, 80, 120, 160])
    arrives = np.array([10, 50, 90, 130, 170])
    np.testing.assert_array_equal(np.flatnonzero(seen.usbl_fresh), arrives)
    np.testing.assert_array_equal(seen.usbl_position_m[arrives], truths.p[arrives - 10])


def test_imu_at_rest_feels_its_weight():
    _, seen = watch(build(noise=False), still(), jax.random.key(0))
    np.testing.assert_array_equal(seen.imu.fresh, [False] + [True] * (N - 1))
    np.testing.assert_array_equal(seen.imu.mean_rate_radps[1:], 0.0)
    weight = np.tile(np.float32([0, 0, G]), (N - 1, 1))
    np.testing.assert_array_equal(seen.imu.specific_force_mps2[1:], weight)
    # Bow up by 30 degrees (about -y): gravity's reaction is g sin 30 ahead, g cos 30 up.
    _, seen = watch(build(noise=False), still(turn=(0.0, -np.pi / 6, 0.0)), jax.random.key(0))
    # float32 rounding of sine and cosine, times g.
    np.testing.assert_allclose(
        seen.imu.specific_force_mps2[1], [G / 2, 0.0, G * np.sqrt(3) / 2], atol=5e-6
    )


def test_imu_in_a_circle_feels_the_centripetal_acceleration_of_its_own_place():
    # 0.8 rad/s on a radius of 2 m, bow ahead: the centre is 2 m to the left.
    rate, radius, arm = 0.8, 2.0, (0.3, -0.2, 0.1)
    angle = np.arange(N) * rate * DT
    zero = np.zeros(N)
    position = radius * np.stack([np.sin(angle), -np.cos(angle), zero], axis=1) + DEEP
    truths = Truth(
        p=jnp.asarray(position, float),
        q=jax.vmap(quaternion.from_yaw)(jnp.asarray(angle, float)),
        nu=jnp.tile(jnp.array([rate * radius, 0, 0, 0, 0, rate]), (N, 1)),
        altitude_m=jnp.full(N, 5.0),
    )
    _, seen = watch(build(noise=False, imu={"offset_m": arm}), truths, jax.random.key(0))
    # Mean of a vector that turns by rate dt, seen from mid-step: shorter by sinc(rate dt / 2).
    short = np.sin(rate * DT / 2) / (rate * DT / 2)
    to_centre = np.array([-arm[0], radius - arm[1], 0.0])
    expected = rate**2 * to_centre * short + [0, 0, G]
    # float32: velocities of 1.6 m/s are known to 1e-7 m/s, divided by dt.
    np.testing.assert_allclose(
        seen.imu.specific_force_mps2[1:], np.tile(expected, (N - 1, 1)), atol=2e-5
    )
    np.testing.assert_allclose(
        seen.imu.mean_rate_radps[1:], np.tile([0, 0, rate], (N - 1, 1)), atol=1e-5
    )


@pytest.mark.parametrize("shift", [0.0, 1e-8, 1e-4, 0.3, 3.0])
def test_turned_is_the_inverse_of_the_exponential(shift):
    rotation = shift * np.array([0.6, -0.48, 0.64])
    with jax.enable_x64(True):
        before = quaternion.exp(jnp.array([0.3, -1.0, 2.0]))
        after = -quaternion.multiply(before, quaternion.exp(jnp.asarray(rotation)))
        # Products of unit quaternions in float64.
        np.testing.assert_allclose(
            instruments.rotation_between(before, after), rotation, atol=1e-15
        )


def test_imu_noise_has_the_density_and_the_walk_of_its_data_sheet():
    n, robots = 2000, 64
    quiet = {"gyro_turn_on_radps": 0.0, "accel_turn_on_mps2": 0.0}
    sensors = build(imu=quiet)
    keys = jax.random.split(jax.random.key(3), robots)
    carry, seen = watch_many(sensors, still(n), keys)
    gyro = np.asarray(seen.imu.mean_rate_radps, np.float64)[:, 1:1997]
    accel = np.asarray(seen.imu.specific_force_mps2, np.float64)[:, 1:1997] - [0, 0, G]

    def allan(x, m):
        """Allan variance at m periods: half the mean square change of means of m."""
        means = x.reshape(robots, -1, m, 3).mean(axis=2)
        return 0.5 * np.mean(np.diff(means, axis=1) ** 2)

    for data, density, walk in ((gyro, 3.394e-4, 3.8785e-5), (accel, 0.004, 0.006)):
        for m in (1, 4):
            tau = m * DT
            # White noise N^2 / tau, rate random walk K^2 tau / 3.
            expected = density**2 / tau + walk**2 * tau / 3
            # 64 x 3 series of at least 499 means: 96,000 squares, relative std below
            # sqrt(3 / 96000) = 0.6 %; four of those.
            np.testing.assert_allclose(allan(data, m), expected, rtol=0.025)
    # After 2,000 steps from zero: K^2 tau/2 (1 - exp(-2 t / tau)); 192 samples, their variance has
    # a relative std of sqrt(2 / 192) = 10 %; four of those.
    for end, walk, tau in ((carry.gyro_walk, 3.8785e-5, 1000.0), (carry.accel_walk, 0.006, 300.0)):
        expected = walk**2 * tau / 2 * (1 - np.exp(-2 * n * DT / tau))
        np.testing.assert_allclose(np.mean(np.square(end)), expected, rtol=0.4)


def test_what_is_drawn_once_has_the_right_spread():
    sensors, keys = build(), jax.random.split(jax.random.key(4), 4000)
    sampled = jax.vmap(suite.reset, (None, 0, None))(sensors, keys, truth())
    for value, std in (
        (sampled.gyro_turn_on, 0.0087),
        (sampled.accel_turn_on, 0.196),
        (sampled.surface_m, 0.02),
        (sampled.heading_bias_rad, np.radians(0.5)),
        (sampled.hard_iron, 0.01),
    ):
        # A standard deviation from 4,000 samples is known to 1 / sqrt(8000) = 1.1 %; four of those.
        np.testing.assert_allclose(np.std(value), std, rtol=0.045)


def test_noise_of_the_slow_instruments_has_the_stated_spread():
    steps, robots = 2000, 64
    n = steps * robots
    tables = {
        "depth": {"surface_offset_m": 0.0, "rate_hz": 20.0},
        "ahrs": {"heading_bias_deg": 0.0, "hard_iron": 0.0, "rate_hz": 20.0},
        "dvl": {"rate_hz": 20.0, "dropout": 0.1},
        "usbl": {"fitted": True, "period_s": 0.05, "latency_s": 0.0, "outlier": 0.1},
        "gps": {"fitted": True, "rate_hz": 20.0, "max_depth_m": 100.0},
    }
    fast = {"nu": (3.0, 4.0, 0.0, 0.0, 0.0, 0.0)}
    keys = jax.random.split(jax.random.key(5), robots)
    _, seen = watch_many(build(**tables), still(steps, **fast), keys)
    seen = jax.tree.map(lambda x: np.asarray(x).reshape(n, *x.shape[2:]), seen)
    # Standard deviations from 128,000 samples are known to 0.2 %: seven of those, as for all here.
    assert np.std(seen.depth_m) == pytest.approx(np.hypot(0.01, 0.002 / np.sqrt(12)), rel=0.015)
    counts = np.asarray(seen.depth_m, np.float64) / 0.002
    # 2,500 steps in float32: rounded to 2.4e-4 steps by the value's own last digit.
    np.testing.assert_allclose(counts, np.round(counts), atol=1e-3)
    turn = quickly(jax.vmap(instruments.rotation_between, (None, 0)))(truth().q, seen.ahrs_q)
    np.testing.assert_allclose(np.std(turn, axis=0), np.radians([0.3, 0.3, 1.0]), rtol=0.015)
    velocity = seen.dvl_velocity_mps[seen.dvl_fresh]
    np.testing.assert_allclose(np.std(velocity, axis=0), np.hypot(0.005, 0.003 * 5), rtol=0.015)
    # 128,000 draws of probability 0.1: std 107 around 12,800.
    assert n - seen.dvl_fresh.sum() == pytest.approx(0.1 * n, abs=430)
    off = seen.usbl_position_m - np.array(DEEP)
    std = np.hypot(0.1, 0.0175 * np.sqrt(30.0))
    # The share of outliers within a metre is below a thousandth; nine tenths are good.
    good = np.linalg.norm(off, axis=1) < 6 * std
    assert np.std(off[good]) == pytest.approx(std, rel=0.015)
    assert n - good.sum() == pytest.approx(0.1 * n, abs=430)
    assert np.std(off[~good]) == pytest.approx(10.0, rel=0.02)
    np.testing.assert_allclose(np.std(seen.gps_position_m, axis=0), 0.5, rtol=0.015)


def test_hard_iron_swings_the_heading_once_a_turn():
    tables = {"heading_bias_deg": 0.0, "heading_noise_deg": 0.0, "level_noise_deg": 0.0}
    sensors = build(ahrs={**tables, "hard_iron": 0.1})
    headings = np.linspace(-3.0, 3.0, 50)
    carry = suite.reset(sensors, jax.random.key(6), truth())
    iron = np.asarray(carry.hard_iron, np.float64)

    def read(heading):
        exact = truth(turn=(0.0, 0.0, heading))
        q = instruments.measure_attitude(sensors.ahrs, carry, exact, jnp.zeros(3), True)
        return instruments.rotation_between(exact.q, q)

    off = np.asarray(jax.vmap(read)(jnp.asarray(headings)))
    # The compass needle: the direction of the field in F, of length one from north, plus the iron.
    seen = np.exp(1j * (np.pi / 2 - headings)) + iron[0] + 1j * iron[1]
    expected = np.angle(np.exp(1j * (np.pi / 2 - headings)) / seen)
    # float32.
    np.testing.assert_allclose(off[:, 2], expected, atol=1e-6)
    assert np.abs(off[:, 2]).max() > 0.5 * np.linalg.norm(iron)


@pytest.mark.parametrize(
    ("altitude", "tilt_deg", "locked"),
    [
        *[(5, 0, True), (0.04, 0, False), (0.06, 0, True), (49, 0, True), (51, 0, False)],
        *[(5, 34, True), (5, 36, False), (5, 180, False)],
    ],
)
def test_dvl_needs_the_bottom_below_it(altitude, tilt_deg, locked):
    sensors = build(dvl={"dropout": 0.0})
    at = still(altitude=float(altitude), turn=(np.radians(tilt_deg), 0.0, 0.0))
    _, seen = watch(sensors, at, jax.random.key(0))
    assert bool(seen.dvl_fresh[0]) == locked


def test_instruments_that_are_not_fitted_say_nothing():
    off = {name: {"fitted": False} for name in ("depth", "ahrs", "dvl", "usbl", "gps")}
    _, seen = watch(build(**off), still(p=(0.0, 0.0, 0.0)), jax.random.key(0))
    for name in ("depth", "ahrs", "dvl", "usbl", "gps"):
        assert not getattr(seen, f"{name}_fresh").any()


def test_readings_depend_on_key_and_step_alone():
    sensors, key = build(**ALL), jax.random.key(8)
    turning = jax.tree.map(lambda x, y: jnp.concatenate([x[:40], y[40:]]), still(), wander())
    here, later = (watch(sensors, truths, key)[1] for truths in (still(), turning))
    other = watch(sensors, still(), jax.random.fold_in(key, 1))[1]
    for a, b, c in zip(*(jax.tree.leaves(x) for x in (here, later, other)), strict=True):
        # What comes later counts for nothing.
        np.testing.assert_array_equal(a[:40], b[:40])
        if a.dtype != bool and np.any(a):
            assert np.any(a != c)


def test_measure_runs_on_lanes():
    with jax.enable_x64(True):
        sensors, n = build(**ALL), 16
        truths = wander(n)
        carries = jax.vmap(suite.reset, (None, 0, 0))(
            sensors, jax.random.split(jax.random.key(0), n), truths
        )
        normal = jnp.asarray(np.random.default_rng(1).normal(size=(n, suite.N_NORMAL)))
        at = jnp.arange(n, dtype=jnp.int32) * 5
        function = partial(suite.read_instruments, sensors)
        arguments = (carries, normal, at, wander(n, seed=2))
        theirs = jax.jit(jax.vmap(function))(*arguments)
        ours = jax.jit(lambda *a: lanes.join(lanes.apply(function, *lanes.split(a))))(*arguments)
        for x, y in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
            # The same operations in another order, in float64.
            x = np.broadcast_to(x, y.shape) if x.ndim == y.ndim - 1 else x
            np.testing.assert_allclose(x, y, rtol=1e-12, atol=1e-12)


def test_rates_become_whole_periods():
    sensors = build(dt=0.03, depth={"rate_hz": 500.0}, dvl={"rate_hz": 5.0})
    assert (int(sensors.depth.every), int(sensors.dvl.every)) == (1, 7)


def test_bad_configurations_are_refused():
    with pytest.raises(ConfigError, match=r"latency_s = 2.0: must be shorter than period_s = 2.0"):
        build(usbl={"fitted": True, "latency_s": 2.0})
    with pytest.raises(ConfigError, match=r"min_altitude_m = 60.0: must be below"):
        build(dvl={"min_altitude_m": 60.0})
    with pytest.raises(ValidationError):
        SensorsConfig.model_validate({"dvl": {"dropout": 1.0}})
    with pytest.raises(ValidationError):
        SensorsConfig.model_validate({"depth": {"noise": 0.1}})
