"""Allocation: what the thrusters really deliver of a wrench, and what is given up first."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import linprog

from angler_kernels import lanes, thruster
from angler_mjx.robot.control import allocation
from angler_mjx.robot.control.commands import BodyWrench
from angler_mjx.robot.vehicles import library, params
from angler_mjx.robot.vehicles.thrusters import PWM_LOW_US, PWM_STEP_US

from ...compiling import quickly

N = 200
HEAVY, LIGHT = 0, 1
ATTITUDE, HEAVE, PLANE = slice(3, 6), 2, slice(0, 2)


@pytest.fixture(scope="module")
def vehicles():
    return params.stack_vehicles(
        [
            params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0),
            params.build_vehicle(library.load_vehicle("bluerov2"), "blue_gazebo", 14.8),
        ]
    )


@pytest.fixture(scope="module")
def deliver(vehicles):
    """PWM, thrust and wrench of every vehicle for wrenches [2, N, 6]."""
    given = allocation.build_allocation(vehicles)

    def one(given, B, tau):
        pwm = allocation.allocate(given, BodyWrench(tau=tau)).pwm_us
        look = jax.vmap(thruster.lookup, (None, 0, None, None))
        thrust = look(given.thrust_n, pwm, PWM_LOW_US, PWM_STEP_US)
        return pwm, thrust, jnp.sum(B * thrust, axis=1)

    many = quickly(jax.vmap(jax.vmap(one, (None, None, 0))))
    return lambda tau: tuple(map(np.asarray, many(given, vehicles.B, jnp.asarray(tau))))


def wrenches(scale, seed=0):
    return np.random.default_rng(seed).normal(size=(2, N, 6)) * scale


SMALL = np.array([10, 10, 12, 1, 1, 1.5])
# float32 sums of eight thrusts, each with the table's inverse in between (a thrust step of 0.3 N
# per 4 us read at 1e-4 us: 1e-5 N), and thrusts below 0.005 N left out.
NEAR = 8 * 0.005


def test_an_unsaturated_demand_is_delivered(deliver, deviation):
    tau = wrenches(SMALL)
    _, _, got = deliver(tau)
    deviation("allocation.unsaturated", np.abs(got - tau)[HEAVY], NEAR)
    five = [0, 1, 2, 3, 5]
    deviation("allocation.unsaturated", np.abs(got - tau)[LIGHT][:, five], NEAR)
    # Pitch is not commanded there: it is what the surge thrusters' arm of 0.011 m makes of surge.
    assert np.abs(got[LIGHT, :, 4] + 0.011 * got[LIGHT, :, 0]).max() < 1e-4  # float32


def test_no_demand_is_neutral(deliver):
    pwm, thrust, _ = deliver(np.zeros((2, N, 6)))
    np.testing.assert_array_equal(pwm, 1500)
    np.testing.assert_array_equal(thrust, 0)
    # A wrench that is only rounding does not make thrusters jump across their dead band.
    pwm, _, _ = deliver(wrenches(1e-4))
    np.testing.assert_array_equal(pwm, 1500)


def test_thrusters_that_are_not_there_stay_neutral(deliver):
    pwm, thrust, _ = deliver(wrenches(100 * SMALL))
    np.testing.assert_array_equal(pwm[LIGHT, :, 6:], 1500)
    np.testing.assert_array_equal(thrust[LIGHT, :, 6:], 0)


def test_signals_stay_within_their_range(deliver):
    for scale in (1, 10, 1000):
        pwm, _, got = deliver(wrenches(scale * SMALL))
        assert np.all(np.isfinite(got))
        assert pwm.min() >= 1100
        assert pwm.max() <= 1900


def test_attitude_comes_first(deliver, deviation):
    """A demand of attitude that fits is met whatever else is asked for."""
    tau = wrenches(SMALL)
    tau[..., :3] *= 50
    _, _, got = deliver(tau)
    deviation("allocation.attitude_first", np.abs(got - tau)[HEAVY][:, ATTITUDE], NEAR)
    deviation("allocation.attitude_first", np.abs(got - tau)[LIGHT][:, [3, 5]], NEAR)


def test_heave_comes_before_surge_and_sway(deliver, deviation):
    tau = wrenches(SMALL)
    tau[..., PLANE] *= 50
    _, _, got = deliver(tau)
    deviation("allocation.heave_next", np.abs(got - tau)[..., HEAVE], NEAR)


def test_a_sway_of_rounding_takes_no_surge_where_heave_is_at_its_limit(deliver):
    """Sway rolls the vehicle a little, which the vertical thrusters answer; they have no room."""
    tau = np.zeros((2, N, 6))
    tau[..., 0], tau[..., 2] = 20.0, 1000.0
    tau[..., 1] = np.linspace(-1e-3, 1e-3, N)  # float32 of a demand of 20 N is good to 1e-6 N
    pwm, _, got = deliver(tau)
    np.testing.assert_allclose(np.abs(pwm[LIGHT, :, 4:6] - 1500.0), 400.0, atol=0.01)
    np.testing.assert_allclose(got[LIGHT, :, 0], 20.0, atol=NEAR)


def test_surge_and_sway_keep_their_direction(deliver, deviation):
    tau = wrenches(SMALL)
    tau[..., PLANE] *= 50
    _, _, got = deliver(tau)
    asked, given = tau[..., PLANE], got[..., PLANE]
    across = asked[..., 0] * given[..., 1] - asked[..., 1] * given[..., 0]
    aside = np.abs(across) / np.linalg.norm(asked, axis=-1)
    deviation("allocation.direction", aside, NEAR)
    share = np.sum(asked * given, axis=-1) / np.sum(asked**2, axis=-1)
    assert np.all(share > 0)
    assert np.all(share < 1.001)  # NEAR on demands above 40 N.
    assert np.mean(share < 0.9) > 0.5  # The demand did saturate.


def test_a_saturated_demand_runs_a_thruster_at_its_end(deliver, vehicles):
    """What is given up is no more than what must be."""
    tau = np.zeros((2, N, 6))
    tau[..., PLANE] = wrenches(1.0)[..., PLANE] * 1e4
    pwm, thrust, _ = deliver(tau)
    ends = np.asarray(vehicles.thrust_n)[:, None, [0, -1]]
    room = np.minimum(ends[..., 1:] - thrust, thrust - ends[..., :1])
    assert room.min(axis=-1).max() < 1e-3  # float32 on 50 N through the table.
    assert np.all((pwm.min(axis=-1) < 1100.1) | (pwm.max(axis=-1) > 1899.9))


# Beyond what the thrusters can: nearly every demand runs some thruster to its end.
LARGE = np.array([80, 80, 100, 8, 8, 12])
FAULTS = [
    ("bluerov2_heavy", {}),
    ("bluerov2", {}),
    ("bluerov2_heavy", {"thruster_6": 0.0}),
    ("bluerov2_heavy", {"thruster_1": 0.0}),
    ("bluerov2_heavy", {"thruster_5": 0.4, "thruster_2": 0.7}),
    ("bluerov2", {"thruster_5": 0.0}),
]


@pytest.fixture(scope="module")
def faulty():
    """Allocations of sound and faulty vehicles, in float64."""
    with jax.enable_x64(True):
        robots = [
            params.build_vehicle(
                library.load_vehicle(name), "blue_gazebo", 14.8, thruster_health=health
            )
            for name, health in FAULTS
        ]
        return params.stack_vehicles(robots), allocation.build_allocation(
            params.stack_vehicles(robots)
        )


@pytest.fixture(scope="module")
def methods(faulty):
    """By name: functions of wrenches [6 vehicles, n, 6] that give PWM and realised wrenches."""

    def jitted(method):
        def one(given, tau):
            pwm = method(given, BodyWrench(tau=tau))
            return pwm.pwm_us, allocation.realised_wrench(given, pwm).tau

        many = quickly(jax.vmap(jax.vmap(one, (None, 0))))

        def run(tau):
            with jax.enable_x64(True):
                return tuple(map(np.asarray, many(faulty[1], jnp.asarray(tau))))

        return run

    methods = (allocation.allocate, allocation.allocate_to_limits)
    return {method.__name__: jitted(method) for method in methods}


def demands(scale, n=40, seed=0):
    return np.random.default_rng(seed).normal(size=(len(FAULTS), n, 6)) * scale


def best(B, commanded, low, high, tau):
    """What can be had of a wrench, group after group, by linear programming."""
    had = np.zeros(6)
    for axes in (ATTITUDE, slice(2, 3), PLANE):
        more = np.zeros(6)
        more[axes] = tau[axes]
        more *= commanded
        n = B.shape[1]
        found = linprog(
            np.append(np.zeros(n), -1.0),
            A_eq=np.hstack([B, -more[:, None]])[commanded],
            b_eq=had[commanded],
            bounds=[(low, high)] * n + [(0, 1)],
        )
        assert found.status == 0
        had = had + found.x[-1] * more
    return had


def test_to_limits_meets_all_that_can_be_met(faulty, methods, deviation):
    """Against linear programming: attitude, then heave, then surge and sway along their line."""
    vehicles, given = faulty
    tau = demands(LARGE)
    pwm, got = methods["allocate_to_limits"](tau)
    assert pwm.min() >= 1100
    assert pwm.max() <= 1900
    short = []
    for k, rows in enumerate(tau):
        B, inverse = np.asarray(given.B[k]), np.asarray(given.B_inverse[k])
        commanded = np.diag(B @ inverse) > 0.5
        low, high = np.asarray(vehicles.thrust_n[k])[[0, -1]]
        for wanted, gives in zip(rows, got[k], strict=True):
            can = best(B, commanded, low, high, wanted)
            # Thrusts below 0.005 N are left out; the solver's 1e-7 is far less.
            deviation.close("allocation.to_limits", gives[commanded], can[commanded], atol=NEAR)
            short.append(np.abs(wanted - can)[commanded].max() > 1.0)
    assert np.mean(short) > 0.5  # The demands did saturate.


def test_to_limits_gives_more_attitude_than_the_pseudo_inverse(methods):
    tau = demands(LARGE)[0, :, ATTITUDE]
    shares = []
    for name in ("allocate", "allocate_to_limits"):
        got = methods[name](demands(LARGE))[1][0, :, ATTITUDE]
        shares.append(np.sum(got * tau, axis=-1) / np.sum(tau**2, axis=-1))
    # Thrusts below 0.005 N are left out, of moments of 14 N m.
    assert np.all(shares[1] >= shares[0] - 1e-3)
    assert np.max(shares[1] - shares[0]) > 0.1


def test_without_saturation_both_are_the_pseudo_inverse(methods):
    tau = demands(SMALL / 4)
    plain, _ = methods["allocate"](tau)
    full, got = methods["allocate_to_limits"](tau)
    # float64; the dead band's edges are a jump, but both leave it at the same thrust.
    np.testing.assert_allclose(full, plain, rtol=0, atol=1e-6)
    assert np.abs(got - tau)[0].max() < NEAR


def test_dead_thrusters_are_not_asked_and_the_wrench_is_met_by_the_others(methods):
    tau = demands(SMALL / 4)
    for run in methods.values():
        pwm, got = run(tau)
        np.testing.assert_array_equal(pwm[2, :, 5], 1500)
        np.testing.assert_array_equal(pwm[3, :, 0], 1500)
        # Seven thrusters of the Heavy still command all six axes; weak ones, too.
        assert np.abs(got - tau)[[2, 3, 4]].max() < NEAR
        # With one vertical thruster of two, the small one keeps heave and gives up roll.
        np.testing.assert_array_equal(pwm[5, :, 4], 1500)
        assert np.abs(got - tau)[5][:, [0, 1, 2, 5]].max() < NEAR


def test_an_unknown_fault_is_asked_as_before(faulty):
    vehicles, _ = faulty
    with jax.enable_x64(True):
        sound = allocation.build_allocation(vehicles, np.ones((len(FAULTS), 8)))
    np.testing.assert_array_equal(sound.B_inverse[2], sound.B_inverse[0])
    np.testing.assert_array_equal(sound.B[2], vehicles.B[0])


@pytest.mark.parametrize("unit", [2.0**-10, 2.0**20])
def test_what_is_no_thrust_does_not_depend_on_the_unit(faulty, unit):
    """A thruster's unit of thrust scales B, and so what is asked; not who is asked for nothing."""
    vehicles, given = faulty
    with jax.enable_x64(True):
        scaled = allocation.build_allocation(replace(vehicles, B=unit * np.asarray(vehicles.B)))
    ours, plain = np.asarray(scaled.B_inverse), np.asarray(given.B_inverse)
    np.testing.assert_array_equal(ours == 0.0, plain == 0.0)
    # float64.
    np.testing.assert_allclose(unit * ours, plain, atol=1e-9)


def test_a_mode_makes_no_wrench_even_in_a_block_of_several(faulty):
    """Two redundancies of thrusters 0 to 2 and 1 to 3: 0 and 3 meet only through the others."""
    rng = np.random.default_rng(0)
    null = np.zeros((2, 8))
    null[0, :3], null[1, 1:4] = 1.0, (1.0, -1.0, 1.0)
    others = np.linalg.svd(null)[2][2:]
    B = rng.normal(size=(6, 6)) @ others
    with jax.enable_x64(True):
        vehicle = jax.tree.map(lambda leaf: leaf[:1], faulty[0])
        built = allocation.build_allocation(replace(vehicle, B=jnp.asarray(B[None])))
    mode, owner = np.asarray(built.mode[0]), np.asarray(built.mode_of[0])
    assert np.abs(mode).max() == 1.0
    for one in np.unique(owner):
        # float64 of sums of four terms of some newtons.
        np.testing.assert_allclose(B @ np.where(owner == one, mode, 0.0), 0.0, atol=1e-9)


def test_on_lanes_it_is_the_same(faulty, methods):
    tau = demands(LARGE)[4]
    with jax.enable_x64(True):
        mine = jax.tree.map(lambda leaf: leaf[4], faulty[1])
        table = lanes.LookupTable(lambda at: mine.thrust_n[at], (201,), mine.thrust_n.dtype, base=0)
        held = jax.tree.map(
            lambda leaf: lanes.pack([np.asarray(x)[()] for x in leaf.ravel()], leaf.shape),
            replace(mine, thrust_n=jnp.zeros(1)),
        )
        command = BodyWrench(tau=lanes.split(jnp.asarray(tau)))
        ours = lanes.join(
            lanes.apply(allocation.allocate_to_limits, replace(held, thrust_n=table), command)
        )
    pwm, _ = methods["allocate_to_limits"](demands(LARGE))
    # float64 on signals of 1e3 us.
    np.testing.assert_allclose(ours.pwm_us, pwm[4], rtol=0, atol=1e-8)


def test_what_a_full_thruster_has_no_room_for_is_left_out_and_not_undone():
    """Three thrusters of 50 N: roll fills the first two, heave asks for a hair more of them.

    Filled, a thruster may stand a rounding beyond its end. What the heave asks of it is less than
    that rounding: met "as far as it fits" it would be asked for backwards, and with it the third
    thruster, which gives all of its 40 N to heave.
    """
    most, hair, n = 50.0, 1.2e-4, 64
    heave, roll = np.array([hair, hair, 40.0]), np.array([1.0, 1.0, 0.0])
    given = allocation.AllocationParams(
        B_inverse=jnp.asarray(np.stack([0 * roll, 0 * roll, heave, roll, 0 * roll, 0 * roll], 1)),
        thrust_n=jnp.linspace(-most, most, 201),
        B=jnp.zeros((6, 3)),
        mode=jnp.array([1.0, -1.0, 0.0]),
        mode_of=jnp.array([0, 0, 2], jnp.int32),
    )
    tau = jnp.zeros((n, 6)).at[:, 2].set(1.0).at[:, 3].set(jnp.linspace(60.0, 90.0, n))
    for how in (allocation.allocate, allocation.allocate_to_limits):
        pwm = jax.vmap(how, (None, 0))(given, BodyWrench(tau=tau)).pwm_us
        # Neutral, or what is met of the heave: never astern.
        assert pwm[:, 2].min() >= 1500.0
        np.testing.assert_allclose(pwm[:, :2], 1900.0, atol=0.01)
