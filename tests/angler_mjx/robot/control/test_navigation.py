"""The navigation filter: against a textbook filter in numpy, and over hundreds of noisy runs."""

from dataclasses import replace
from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from angler_kernels import lanes
from angler_mjx.robot.control import error_state, navigation
from angler_mjx.robot.control.navigation import NavigationCarry, NavigationParams
from angler_mjx.robot.sensing.readings import ImuReading, Reading

from ...compiling import quickly
from . import navigating as world

RUNS, SECONDS = 200, 60
correct = quickly(navigation.correct)
USBL = {"fitted": True, "outlier": 0.0}
ARMS = {
    "imu": {"offset_m": (0.2, 0.1, -0.1)},
    "dvl": {"offset_m": (-0.1, 0.2, 0.3)},
    "usbl": {**USBL, "offset_m": (0.3, 0.1, 0.2)},
}
FILTERS = {
    "dead reckoning with DVL": {},
    "USBL": {"usbl": USBL},
    "arms": ARMS,
    "late USBL": {"usbl": {**USBL, "latency_s": 1.9}},
    "prompt USBL": {"usbl": {**USBL, "latency_s": 0.0}},
    "outliers": {"usbl": {**USBL, "outlier": 0.1}},
    "without DVL": {"dvl": {"fitted": False}},
}
"""All with the errors that the defaults say, constant ones included."""


@pytest.fixture(scope="module")
def truths():
    return world.times(jnp.float32, SECONDS)


class Flown(dict):
    """Errors, covariances, standard deviations, rejections of each filter: [run, second, ...].

    A filter flies when it is asked for first: each is a program of its own.
    """

    def __init__(self, truths):
        self._truths = truths

    def __missing__(self, name):
        keys = jax.random.split(jax.random.key(1), RUNS)
        filters = world.build(**FILTERS[name])
        self[name] = jax.device_get(world.fleet(filters, self._truths, keys))
        return self[name]


@pytest.fixture(scope="module")
def flown(truths):
    return Flown(truths)


def rms(flown, name, second):
    return np.sqrt(np.mean(np.square(flown[name][0][:, second], dtype=np.float64), axis=0))


def nees(error, covariance):
    """Squared error in units of its covariance, [run, second]."""
    error, covariance = error.astype(np.float64), covariance.astype(np.float64)
    return np.sum(error * np.linalg.solve(covariance, error[..., None])[..., 0], axis=-1)


DAILY = ("dead reckoning with DVL", "USBL")
WHEN = {
    name: name
    if name in DAILY
    else pytest.param(name, marks=pytest.mark.nightly(by="the filter without noise, and two with"))
    for name in FILTERS
}
"""A fleet with each filter takes seconds: two fly in every run of the tests."""


@pytest.mark.parametrize("name", [WHEN[name] for name in FILTERS if name != "prompt USBL"])
def test_the_covariance_says_how_large_the_errors_are(flown, name):
    error, covariance, _, _ = flown[name]
    mean = nees(error, covariance).mean(axis=0)
    # The sum over runs is chi-square with 19 RUNS degrees of freedom; 60 seconds are looked at, so
    # the bounds are those of one in ten thousand.
    low, high = chi2.ppf([5e-5, 1 - 5e-5], 19 * RUNS) / RUNS
    assert np.all((mean > low) & (mean < high)), (mean.min(), mean.max(), low, high)


def test_every_component_is_as_uncertain_as_it_says(flown):
    error, covariance, _, _ = flown["USBL"]
    said = np.sqrt(np.mean(np.einsum("ntii->nti", covariance)[:, -1], axis=0))
    # A standard deviation from 200 runs is known to 5 %; four of those.
    np.testing.assert_allclose(rms(flown, "USBL", -1), said, rtol=0.2)
    assert error.shape == (RUNS, SECONDS, 19)


def test_with_dvl_the_position_drifts_by_centimetres_in_a_minute(flown):
    start, end = (rms(flown, "dead reckoning with DVL", k)[:3] for k in (0, -1))
    # It starts 10 cm off along each axis and nothing but depth tells; 40 m of way add 3 cm, and
    # half a degree of heading as much, 3 m away from the start.
    assert np.all(np.hypot(0.045, start[:2]) > end[:2] * 0.95)
    # The zero of the pressure sensor's scale: 2 cm, to 5 % from 200 runs; four of those.
    assert end[2] == pytest.approx(0.02, rel=0.2)
    # Half a degree of 0.85 m/s.
    assert np.all(rms(flown, "dead reckoning with DVL", -1)[3:6] < 0.0075)


@pytest.mark.nightly(by="dead reckoning, and fixes prompt and late")
def test_without_dvl_the_position_is_lost(flown):
    error = rms(flown, "without DVL", slice(None))
    horizontal = np.hypot(error[:, 0], error[:, 1])
    # Errors in the horizontal acceleration that no instrument shows: metres within 20 s, and more
    # than twice that in three times the time. Depth, roll and pitch stay.
    assert horizontal[19] > 1.0
    assert horizontal[59] > 2.0 * horizontal[19]
    assert np.all(error[19:, 2] < 0.025)
    assert np.all(error[19:, 6:8] < 0.004)


def test_usbl_bounds_the_position(flown):
    assert np.all(rms(flown, "USBL", -1)[:2] < 0.04)
    assert np.all(rms(flown, "dead reckoning with DVL", -1)[:2] > 0.08)


@pytest.mark.nightly(by="test_without_noise_the_filter_stays_on_the_truth")
def test_a_late_fix_is_worth_nearly_as_much_as_a_prompt_one(flown):
    late, prompt = (
        rms(flown, name, slice(40, None))[:, :2] for name in ("late USBL", "prompt USBL")
    )
    # One to two fixes fewer of thirty, and the way reckoned in 1.9 s is off by under a centimetre.
    assert np.mean(late) < 1.1 * np.mean(prompt)


@pytest.mark.nightly(by="test_good_readings_are_seldom_thrown_away")
def test_outliers_are_thrown_away(flown):
    rejected = flown["outliers"][3].sum(axis=(0, 1))
    fixes = RUNS * 30
    # A tenth are outliers of 10 m, against a few decimetres; drawn with a std of 0.4 %.
    assert rejected[3] == pytest.approx(0.1 * fixes, rel=0.15)
    assert np.all(rms(flown, "outliers", -1)[:2] < 1.15 * rms(flown, "USBL", -1)[:2])


def test_good_readings_are_seldom_thrown_away(flown):
    rejected = flown["USBL"][3].sum(axis=(0, 1))
    given = RUNS * SECONDS * np.array([10, 10, 5, 0.5])
    # One in a thousand is what the gate is set to; the rarest, 6,000 fixes, has a std of 2.4.
    assert np.all(rejected[:4] < 1.2e-3 * given + 8)
    assert np.all(rejected[:3] > 0.5e-3 * given[:3])


def test_constant_errors_are_found_where_another_instrument_shows_them(flown):
    start, said = (flown["USBL"][2][:, k].mean(axis=0) for k in (0, -1))
    # Turning shows the iron, against the gyroscopes; way against fixes shows the heading; fixes
    # show depth as well as the horizontal.
    assert np.all(said[15:] < 0.85 * start[15:])
    assert np.all(said[17:] < 0.5 * start[17:])
    # With pressure alone nothing tells an offset of its scale from depth.
    alone = flown["dead reckoning with DVL"][2][:, -1].mean(axis=0)
    assert alone[2] == pytest.approx(0.02, rel=0.02)
    assert alone[15] == pytest.approx(0.02, rel=0.02)


@pytest.mark.parametrize("name", WHEN.values())
def test_covariances_stay_positive_in_float32(flown, name):
    _, covariance, _, _ = flown[name]
    # Variances of the biases are of the order of 1e-8 at least.
    assert np.linalg.eigvalsh(covariance.astype(np.float64)).min() > 1e-9
    np.testing.assert_array_equal(covariance, np.swapaxes(covariance, -1, -2))


def test_a_run_depends_on_its_key_alone(truths, flown):
    """The same run alone, twice, and among 200 for 5 s, in which rounding does not grow much."""
    first, other = jax.random.split(jax.random.key(1), RUNS)[:2, None]
    fly = partial(world.alone, world.build(**FILTERS["USBL"]), truths)
    once, again, another = (jax.device_get(fly(key)) for key in (first, first, other))
    for x, y, among in zip(once, again, flown["USBL"], strict=True):
        np.testing.assert_array_equal(x, y)
        if x.dtype == np.float32:
            np.testing.assert_allclose(x[0, :5], among[0, :5], rtol=1e-3, atol=1e-5)
    assert np.all(once[0] != another[0])


def test_without_noise_the_filter_stays_on_the_truth(truths):
    exact = world.build(noise=False, **FILTERS["arms"])
    with jax.enable_x64(True):
        double = jax.tree.map(
            lambda x: jnp.asarray(x, jnp.float64 if x.dtype == jnp.float32 else x.dtype), exact
        )
        key = jax.random.split(jax.random.key(0), 1)
        off = jax.device_get(world.alone(double, world.times(jnp.float64, SECONDS), key)[0])
    single = jax.device_get(world.alone(exact, truths, key)[0])
    # The way of a period by the trapezoidal rule: dt^2 / 12 times the change of acceleration, under
    # 0.1 mm; readings are exact, but the filter goes by its own reckoning too.
    assert np.abs(off[..., :9]).max() < 1e-4
    # float32: positions of 5 m in steps of 5e-7 m, rounded anew in each of 1,200 periods, walk off
    # by 5e-6 m (1 sigma): four of those. Attitudes, in steps of 1e-7, do less.
    np.testing.assert_allclose(single[..., :9], off[..., :9], atol=2e-5)


def random_case(seed=0):
    """A state, its covariance, and readings that are all fresh, in float64."""
    rng = np.random.default_rng(seed)
    scale = np.append(np.repeat([0.3, 0.1, 0.05, 0.01, 0.1], 3), [0.02, 0.01, 0.01, 0.01])
    root = scale[:, None] * rng.normal(size=(19, 19)) / 4
    carry = NavigationCarry(
        p=np.array([1.0, 2.0, -5.0]),
        v=rng.normal(size=3) * 0.5,
        q=np.roll(Rotation.from_rotvec(rng.normal(size=3)).as_quat(), 1),
        gyro_bias=rng.normal(size=3) * 0.01,
        accel_bias=rng.normal(size=3) * 0.1,
        depth_offset=np.array(0.01),
        heading_bias=np.array(0.015),
        # How its error follows from heading is of second order in errors only where it is zero.
        hard_iron=np.zeros(2),
        covariance=root @ root.T + np.diag(scale**2) / 10,
        from_ping=np.array([0.2, -0.1, 0.05]),
    )
    turn = Rotation.from_quat(np.roll(carry.q, -1))
    close = (Rotation.from_rotvec(rng.normal(size=3) * 0.02) * turn).as_quat()
    yes = np.array(True)
    reading = Reading(
        imu=ImuReading(
            fresh=yes,
            rate_radps=rng.normal(size=3) * 0.3,
            mean_rate_radps=rng.normal(size=3) * 0.3,
            specific_force_mps2=turn.inv().apply([0.5, -0.3, 10.0]),
        ),
        depth_fresh=yes,
        depth_m=np.array(5.02),
        ahrs_fresh=yes,
        ahrs_q=np.roll(close, 1),
        dvl_fresh=yes,
        dvl_velocity_mps=turn.inv().apply(carry.v) + rng.normal(size=3) * 0.01,
        usbl_pinged=~yes,
        usbl_fresh=yes,
        usbl_position_m=carry.p - carry.from_ping + rng.normal(size=3) * 0.2,
        gps_fresh=yes,
        gps_position_m=carry.p[:2] + rng.normal(size=2) * 0.5,
    )
    return jax.tree.map(jnp.asarray, (carry, reading))


class Textbook:
    """A believed state that an error [19] can be put on, and what follows from it; numpy alone."""

    def __init__(self, carry, error=None):
        e = np.zeros(19) if error is None else error
        turn = Rotation.from_quat(np.roll(np.asarray(carry.q), -1))
        self.p, self.v = carry.p + e[:3], carry.v + e[3:6]
        self.turn = Rotation.from_rotvec(e[6:9]) * turn
        self.gyro_bias, self.accel_bias = carry.gyro_bias + e[9:12], carry.accel_bias + e[12:15]
        self.depth_offset = carry.depth_offset + e[15]
        self.heading_bias, self.iron = carry.heading_bias + e[16], carry.hard_iron + e[17:]

    def moved(self, reading, dt):
        turned = (np.asarray(reading.imu.mean_rate_radps) - self.gyro_bias) * dt
        middle = self.turn * Rotation.from_rotvec(turned / 2)
        force = middle.apply(reading.imu.specific_force_mps2 - self.accel_bias)
        v = self.v + dt * (force - [0, 0, world.GRAVITY])
        self.p = self.p + dt * (self.v + v) / 2
        self.v, self.turn = v, self.turn * Rotation.from_rotvec(turned)
        return self

    def minus(self, other):
        turn = (self.turn * other.turn.inv()).as_rotvec()
        pairs = [(self.p, other.p), (self.v, other.v), (turn, 0.0)]
        pairs += [(self.gyro_bias, other.gyro_bias), (self.accel_bias, other.accel_bias)]
        pairs += [(self.iron, other.iron)]
        left = [self.depth_offset - other.depth_offset, self.heading_bias - other.heading_bias]
        vectors = [a - b for a, b in pairs]
        return np.concatenate([*vectors[:-1], left, vectors[-1]])

    def compass(self):
        """What the compass is off by: a turn about z."""
        forward = self.turn.as_matrix()[:, 0]
        cos, sin = forward[:2] / np.hypot(*forward[:2])
        x, y = self.iron
        iron = np.arctan2(x * cos - y * sin, 1 + x * sin + y * cos)
        return Rotation.from_rotvec([0, 0, self.heading_bias + iron])

    def predicted(self, s, reading, base):
        """What the instruments would give, in the order of the filter; attitude from ``base``."""
        rate = np.asarray(reading.imu.rate_radps) - self.gyro_bias
        imu = np.asarray(s.imu.offset_m)
        at = lambda x: self.p + self.turn.apply(np.asarray(x.offset_m) - imu)  # noqa: E731
        velocity = self.turn.inv().apply(self.v) + np.cross(rate, s.dvl.offset_m - imu)
        return np.concatenate(
            [
                [self.depth_offset - at(s.depth)[2]],
                (base.compass().inv() * self.compass() * self.turn * base.turn.inv()).as_rotvec(),
                velocity,
                at(s.usbl) - reading.way,
                at(s.gps)[:2],
            ]
        )


def slopes(function, n=19, h=1e-6):
    """Derivative of a function of the error state at zero, by central differences."""
    steps = h * np.eye(n)
    return np.stack([(function(e) - function(-e)) / (2 * h) for e in steps], axis=1)


@pytest.fixture
def _x64():
    with jax.enable_x64(True):
        yield


@pytest.mark.usefixtures("_x64")
def test_prediction_is_that_of_a_filter_with_numerical_derivatives():
    sensors, (carry, reading) = world.build(**ARMS), random_case()
    predict = quickly(navigation.predict)
    after = predict(sensors, carry, reading)
    base = Textbook(carry).moved(reading, world.DT)
    assert np.abs(np.asarray(after.p) - base.p).max() < 1e-12
    assert np.abs(np.asarray(after.v) - base.v).max() < 1e-12
    turn = Rotation.from_quat(np.roll(np.asarray(after.q), -1)) * base.turn.inv()
    assert turn.magnitude() < 1e-12
    np.testing.assert_allclose(after.from_ping, carry.from_ping + base.p - carry.p, atol=1e-12)
    F = slopes(lambda e: Textbook(carry, e).moved(reading, world.DT).minus(base))
    quiet = replace(
        sensors.imu,
        **{k: jnp.zeros(()) for k in ("gyro_std", "accel_std", "gyro_walk_std", "accel_walk_std")},
    )
    ours = predict(replace(sensors, imu=quiet), carry, reading).covariance
    expected = F @ np.asarray(carry.covariance) @ F.T
    scale = np.sqrt(np.diag(expected))
    # What is left out of F is of second order in the rotation of a period (0.02 rad) times dt:
    # how an attitude error of mid-step follows from the gyro bias. 2e-3 of the largest entries.
    np.testing.assert_allclose(
        ours / np.outer(scale, scale), expected / np.outer(scale, scale), atol=2e-3
    )
    # White noise: the covariance of the integral and double integral, and random walks.
    added = np.asarray(after.covariance - ours)
    dt, a = world.DT, 0.004**2
    assert added[0, 0] == pytest.approx(a * dt**3 / 3)
    assert added[1, 4] == added[4, 1] == pytest.approx(a * dt**2 / 2)
    assert added[5, 5] == pytest.approx(a * dt)
    assert added[7, 7] == pytest.approx(3.394e-4**2 * dt)
    # The bias that wanders back to zero gains less by dt / tau.
    assert added[9, 9] == pytest.approx(3.8785e-5**2 * dt, rel=1e-4)
    assert added[14, 14] == pytest.approx(0.006**2 * dt, rel=1e-3)
    assert np.count_nonzero(np.abs(added) > 1e-15) == 15 + 6


@pytest.mark.usefixtures("_x64")
def test_correction_is_that_of_one_update_with_the_whole_gain():
    sensors, (carry, reading) = world.build(**ARMS), random_case()
    after, rejected = correct(sensors, carry, reading)
    assert not np.any(rejected)
    base = Textbook(carry)
    arm = base.turn.apply(np.asarray(sensors.usbl.offset_m - sensors.imu.offset_m))
    read = SimpleNamespace(imu=reading.imu, way=np.asarray(carry.from_ping) + arm)
    H = slopes(lambda e: Textbook(carry, e).predicted(sensors, read, base))
    ahrs = Rotation.from_quat(np.roll(np.asarray(reading.ahrs_q), -1))
    measured = np.concatenate(
        [
            [reading.depth_m],
            (base.compass().inv() * ahrs * base.turn.inv()).as_rotvec(),
            reading.dvl_velocity_mps,
            reading.usbl_position_m,
            reading.gps_position_m,
        ]
    )
    P = np.asarray(carry.covariance)
    distance = np.linalg.norm(carry.p)
    speed = np.linalg.norm(reading.dvl_velocity_mps)
    variance = np.concatenate(
        [
            [0.01**2 + 0.002**2 / 12],
            np.radians([0.3, 0.3]) ** 2,
            [np.radians(1.0) ** 2],
            [0.005**2 + (0.003 * speed) ** 2] * 3,
            0.1**2 + (0.0175 * distance) ** 2 + 0.5**2 * np.diag(P)[3:6],
            [0.5**2] * 2,
        ]
    )
    S = H @ P @ H.T + np.diag(variance)
    K = P @ H.T @ np.linalg.inv(S)
    error = K @ (measured - base.predicted(sensors, read, base))
    Q = np.eye(19) - K @ H
    expected = Q @ P @ Q.T + K @ np.diag(variance) @ K.T
    scale = np.sqrt(np.diag(P))
    # Central differences are good to 1e-9; the gains magnify that by up to 1e3.
    np.testing.assert_allclose(after.covariance, expected, atol=1e-6 * scale.min() ** 2, rtol=1e-5)
    corrected = Textbook(carry, error)
    ours = Textbook(after)
    np.testing.assert_allclose(ours.minus(corrected) / scale, 0.0, atol=1e-6)


@pytest.mark.usefixtures("_x64")
def test_a_reading_that_is_not_fresh_changes_nothing():
    sensors, (carry, reading) = world.build(**ARMS), random_case()
    names = ("depth", "ahrs", "dvl", "usbl", "gps")
    stale = replace(reading, **{f"{name}_fresh": jnp.array(False) for name in names})
    after, rejected = correct(sensors, carry, stale)
    # The quaternion is made of unit length again.
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-15, atol=1e-16), after, carry)
    assert not np.any(rejected)
    wild = replace(reading, depth_m=jnp.array(50.0))
    before, _ = correct(sensors, carry, replace(reading, depth_fresh=jnp.array(False)))
    after, rejected = correct(sensors, carry, wild)
    jax.tree.map(np.testing.assert_array_equal, after, before)
    np.testing.assert_array_equal(rejected, [True, False, False, False, False])


@pytest.mark.usefixtures("_x64")
def test_the_gate_is_the_squared_innovation_in_units_of_its_covariance():
    carry, _ = random_case()
    rng = np.random.default_rng(2)
    H, y, r = rng.normal(size=(3, 19)), rng.normal(size=3), np.array([0.1, 0.2, 0.3])
    square = y @ np.linalg.solve(H @ np.asarray(carry.covariance) @ H.T + np.diag(r), y)
    for factor, passes in ((1 + 1e-9, True), (1 - 1e-9, False)):
        fuse = error_state.fuse_measurement(
            carry.covariance, jnp.zeros(19), H, y, r, square * factor, jnp.array(True)
        )
        assert bool(fuse[2]) == passes


@pytest.mark.usefixtures("_x64")
def test_step_runs_on_lanes():
    believes = NavigationParams(sensors=world.build(**ARMS))
    cases = [random_case(seed) for seed in range(8)]
    carries, readings = jax.tree.map(lambda *x: jnp.stack(x), *cases)
    function = partial(navigation.step, believes)
    theirs = quickly(jax.vmap(function))(carries, readings)
    # Not compiled: thousands of operations on as many small arrays take XLA minutes on a CPU.
    ours = lanes.join(lanes.apply(function, *lanes.split((carries, readings))))
    for x, y in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        # The same operations in another order; small differences of large numbers in covariances.
        np.testing.assert_allclose(x, y, rtol=1e-9, atol=1e-11)


def test_it_begins_as_far_off_as_it_says(truths):
    first = world.believed(jax.tree.map(lambda x: x[0, 0], truths))
    believes = NavigationParams(sensors=world.build())
    keys = jax.random.split(jax.random.key(2), 2000)
    started = quickly(jax.vmap(navigation.reset, (None, None, 0)))(believes, first, keys)
    # 2,000 samples: 1.6 %; four of those.
    np.testing.assert_allclose(np.std(started.p, axis=0), 0.1, rtol=0.065)
    np.testing.assert_allclose(np.diag(started.covariance[0])[6:9], [1e-4, 1e-4, 9e-4], rtol=1e-6)
    exact = navigation.reset(NavigationParams(sensors=world.build(noise=False)), first, keys[0])
    np.testing.assert_array_equal(exact.p, first.p)
    np.testing.assert_array_equal(exact.q, first.q)
