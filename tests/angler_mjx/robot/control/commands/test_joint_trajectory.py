"""JointTrajectory: against SciPy and solved boundary conditions; joins, tolerances, refusals."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicHermiteSpline

from angler_kernels import lanes
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import trajectory as planned
from angler_mjx.robot.control.commands.joint_goal import (
    GoalError,
    JointGoal,
    JointPoint,
    build_trajectory,
    validate_goal,
)
from angler_mjx.robot.control.commands.joint_tolerance import (
    JointTolerance,
    ResultCode,
    build_tolerances,
    evaluate_goal,
)
from angler_mjx.robot.control.commands.joint_trajectory import (
    VEHICLE_JOINTS,
    JointState,
    from_path,
    replace_at,
    sample_state,
)

from ....compiling import quickly

TIME = np.array([0.0, 1.0, 1.5, 4.0, 6.0])
RNG = np.random.default_rng(0)
P, V, A = (RNG.normal(size=(5, 4)) for _ in range(3))
V[-1] = 0
LENGTH = 8
"""Rows of all trajectories here, so that each function is compiled once."""

_sample_many = quickly(jax.vmap(sample_state, (None, 0)))
join_at = quickly(replace_at)
judge = quickly(evaluate_goal)


def sample_many(path, t):
    """The path at times [n], filled up to 200 of them: one program for all."""
    filled = np.full(200, t[-1], t.dtype)
    filled[: len(t)] = t
    found = _sample_many(path, jnp.asarray(filled))
    return jax.tree.map(lambda leaf: np.asarray(leaf)[: len(t)], found)


def goal(degree, *, joints=VEHICLE_JOINTS, time=TIME, p=P, v=V, a=A):
    n = len(joints)
    return JointGoal(
        joint_names=joints,
        points=tuple(
            JointPoint(
                time_s=float(time[i]),
                positions=tuple(p[i, :n]),
                velocities=tuple(v[i, :n]) if degree >= 3 else (),
                accelerations=tuple(a[i, :n]) if degree == 5 else (),
            )
            for i in range(len(time))
        ),
    )


def made(message, position=P[0], joints=VEHICLE_JOINTS):
    return build_trajectory(message, joints=joints, position=position, size=LENGTH)


def quintic(t, k):
    """Segment k at times t, its six coefficients solved from the six conditions at its ends."""
    span = TIME[k + 1] - TIME[k]
    power = np.arange(6)
    rows = []
    for at in (0.0, span):
        rows += [
            at**power,
            power * at ** np.maximum(power - 1, 0),
            power * (power - 1) * at ** np.maximum(power - 2, 0),
        ]
    ends = np.concatenate([[P[j], V[j], A[j]] for j in (k, k + 1)])
    coefficients = np.linalg.solve(np.array(rows), ends)
    polynomial = np.polynomial.Polynomial
    each = [polynomial(c) for c in coefficients.T]
    return [np.stack([p.deriv(d)(t - TIME[k]) for p in each], axis=1) for d in range(3)]


def expected(degree, t):
    if degree == 1:
        k = np.searchsorted(TIME, t, side="right") - 1
        slope = (np.diff(P, axis=0) / np.diff(TIME)[:, None])[k]
        return [
            np.stack([np.interp(t, TIME, P[:, j]) for j in range(4)], axis=1),
            slope,
            0 * slope,
        ]
    if degree == 3:
        spline = CubicHermiteSpline(TIME, P, V)
        return [spline(t, d) for d in range(3)]
    k = np.searchsorted(TIME, t, side="right") - 1
    rows = [quintic(t[i : i + 1], k[i]) for i in range(t.size)]
    return [np.concatenate([row[d] for row in rows]) for d in range(3)]


WITHIN = np.sort(np.concatenate([TIME[:-1], np.linspace(0, 5.999, 40)]))


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_segments_are_those_of_an_independent_interpolation(degree):
    # Nothing to unwrap here.
    assert np.abs(np.diff(P[:, 3])).max() < np.pi
    with jax.enable_x64(True):
        state = sample_many(made(goal(degree)), jnp.asarray(WITHIN))
        for got, want in zip(
            (state.position, state.velocity, state.acceleration),
            expected(degree, WITHIN),
            strict=True,
        ):
            # float64; accelerations of half a second reach 100.
            np.testing.assert_allclose(got, want, atol=1e-11)


def test_single_precision_is_enough():
    state = sample_many(made(goal(5)), jnp.asarray(WITHIN, jnp.float32))
    got = (state.position, state.velocity, state.acceleration)
    for one, want in zip(got, expected(5, WITHIN), strict=True):
        # A dozen ulp of the largest number, of float32.
        np.testing.assert_allclose(one, want, atol=2e-6 * max(1, np.abs(want).max()))


@pytest.mark.parametrize("rows", [LENGTH, 5], ids=["padded", "exact"])
@pytest.mark.parametrize("degree", [1, 5])
def test_the_last_point_is_held_at_rest(rows, degree):
    path = build_trajectory(goal(degree), joints=VEHICLE_JOINTS, position=P[0], size=rows)
    state = sample_many(path, jnp.array([6.0, 6.5, 1e4]))
    np.testing.assert_allclose(state.position, np.tile(P[-1], (3, 1)), rtol=1e-6)
    np.testing.assert_array_equal(state.velocity, 0)
    np.testing.assert_array_equal(state.acceleration, 0)


def test_a_first_point_later_than_0_is_reached_from_where_the_robot_is():
    here = np.array([1.0, 2.0, -3.0, 0.5])
    path = made(goal(1, time=TIME + 2.0), position=here)
    state = sample_many(path, jnp.array([0.0, 1.0, 2.0]))
    # Halfway on a line; float32.
    np.testing.assert_allclose(state.position, [here, (here + P[0]) / 2, P[0]], atol=1e-6)


def test_joints_that_are_not_named_stay_where_they_are_in_any_order_of_names():
    here = np.array([1.0, 2.0, -3.0, 0.5])
    path = made(goal(3, joints=("z", "x")), position=here)
    state = sample_many(path, jnp.asarray(WITHIN))
    spline = CubicHermiteSpline(TIME, P[:, :2], V[:, :2])(WITHIN)
    np.testing.assert_allclose(state.position[:, 2], spline[:, 0], atol=1e-5)  # float32
    np.testing.assert_allclose(state.position[:, 0], spline[:, 1], atol=1e-5)
    np.testing.assert_array_equal(state.position[:, 1], here[1])
    np.testing.assert_array_equal(np.asarray(state.position[:, 3]), np.float32(here[3]))


def test_joints_that_are_not_named_stay_along_quintics_too():
    here = np.array([1.0, 2.0, -3.0, 0.5])
    state = sample_many(made(goal(5, joints=("z", "x")), position=here), jnp.asarray(WITHIN))
    np.testing.assert_array_equal(state.position[:, 1], here[1])
    np.testing.assert_array_equal(state.velocity[:, [1, 3]], 0)
    np.testing.assert_array_equal(state.acceleration[:, [1, 3]], 0)


def test_degrees_are_the_numbers_that_are_documented():
    for degree in (1, 3, 5):
        np.testing.assert_array_equal(made(goal(degree)).degree[:4], degree)
        # From rest, which is known to every derivative: as much as the first point says.
        assert made(goal(degree, time=TIME + 1.0)).degree[0] == degree


def test_yaw_goes_the_short_way_and_has_no_steps():
    yaw = np.array([3.0, -3.0, 2.5, -2.5, 0.0])
    message = goal(1, joints=("yaw",), p=yaw[:, None])
    state = sample_many(made(message, position=np.array([0, 0, 0, 3.0])), jnp.asarray(TIME))
    got = np.asarray(state.position[:, 3])
    assert np.all(np.abs(np.diff(got)) < np.pi)
    # float32 after two turns.
    np.testing.assert_allclose(np.exp(1j * got), np.exp(1j * yaw), atol=1e-6)


def test_an_arm_joint_is_not_unwrapped():
    joints = (*VEHICLE_JOINTS, "elbow")
    p = np.array([[-3.0], [3.0]])
    message = goal(1, joints=("elbow",), time=TIME[:2], p=p)
    path = made(message, position=np.array([0, 0, 0, 0, -3.0]), joints=joints)
    np.testing.assert_allclose(path.position[:2, 4], [-3.0, 3.0])


@pytest.mark.parametrize("before", [1, 3, 5])
@pytest.mark.parametrize("after", [1, 3, 5])
@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_a_replacement_joins_without_a_step(before, after, shift):
    old = made(goal(before))
    new = made(goal(after, time=TIME + shift, p=P[::-1].copy()))
    joined = join_at(old, jnp.array(2.1), new)
    was, now = (sample_many(path, jnp.array([t])) for path, t in ((old, 2.1), (joined, 0.0)))
    # float32.
    np.testing.assert_allclose(now.position, was.position, atol=2e-6)
    np.testing.assert_allclose(now.velocity, was.velocity, atol=2e-6)
    if after == 5:
        np.testing.assert_allclose(now.acceleration, was.acceleration, atol=1e-5)
    # No step of the velocity where the join ends, either: its speed changes by at most a t.
    end = float(joined.time_s[1])
    around = sample_many(joined, jnp.array([end - 1e-3, end + 1e-3]))
    steepest = np.abs(np.asarray(sample_many(joined, jnp.linspace(0, 6, 200)).acceleration)).max()
    assert np.abs(np.diff(around.velocity, axis=0)).max() <= 2e-3 * steepest + 1e-4


def test_a_replacement_arrives_at_the_points_of_the_new_one():
    new = made(goal(3, time=TIME + 1.0))
    joined = join_at(made(goal(5)), jnp.array(2.1), new)
    state = sample_many(joined, jnp.asarray(TIME[:-1] + 1.0))
    turn = np.exp(1j * np.asarray(state.position[:, 3]))
    np.testing.assert_allclose(state.position[:, :3], P[:-1, :3], atol=2e-6)  # float32
    np.testing.assert_allclose(turn, np.exp(1j * P[:-1, 3]), atol=2e-6)
    np.testing.assert_allclose(state.velocity, V[:-1], atol=2e-6)


@pytest.mark.parametrize("degree", [1, 3, 5])
def test_a_replacement_of_some_joints_stops_the_others_at_once(degree):
    old = made(goal(1))
    new = made(goal(degree, joints=("x",), time=TIME + 1.0))
    joined = join_at(old, jnp.array(2.1), new)
    was = sample_many(old, jnp.array([2.1]))
    state = sample_many(joined, jnp.linspace(0, 9, 50))
    np.testing.assert_allclose(state.position[-1, 0], P[-1, 0], atol=1e-6)  # float32
    others = np.tile(was.position[0, 1:], (50, 1))
    np.testing.assert_allclose(state.position[:, 1:], others, atol=1e-6)
    np.testing.assert_array_equal(state.velocity[:, 1:], 0)


def test_a_turn_after_several_turns_still_goes_the_short_way():
    turns = np.cumsum(np.full(5, 2.0))[:, None]
    old = made(goal(1, joints=("yaw",), p=turns), position=np.zeros(4))
    new = made(goal(1, joints=("yaw",), time=TIME[:2] + 1.0, p=np.zeros((2, 1))))
    joined = join_at(old, jnp.array(6.0), new)
    step = joined.position[1, 3] - joined.position[0, 3]
    # 10 rad is 2.57 rad short of two turns.
    np.testing.assert_allclose(step, 4 * np.pi - 10.0, atol=1e-5)


def test_lanes_give_what_vmap_gives():
    batch = jax.tree.map(
        lambda *x: jnp.stack(x), made(goal(1)), made(goal(3)), made(goal(5, p=2 * P))
    )
    other = jax.tree.map(lambda x: x[::-1], batch)
    t = jnp.array([0.3, 1.2, 4.5])

    def one(old, t, new):
        return sample_state(old, t), sample_state(replace_at(old, t, new), t)

    want = quickly(jax.vmap(one))(batch, t, other)
    split = (lanes.split(x) for x in (batch, t, other))
    got = lanes.join(lanes.apply(one, *split))
    # The same sums in another order; float32.
    jax.tree.map(lambda a, b: np.testing.assert_allclose(a, b, atol=3e-5), got, want)


def test_gradient_is_finite_where_padded():
    def total(position):
        return sample_state(replace(path, position=position), jnp.array(7.0)).position.sum()

    path = made(goal(5))
    gradient = quickly(jax.grad(total))(path.position)
    assert np.all(np.isfinite(gradient))
    np.testing.assert_allclose(gradient.sum(), 4.0)


@pytest.mark.parametrize("joints", [("x",), VEHICLE_JOINTS], ids=len)
def test_a_replacement_of_two_points_ends_its_join_with_the_speed_of_the_line(joints):
    """No row more than is needed: the start and two points."""
    n = len(joints)
    old = build_trajectory(goal(1, joints=joints), joints=joints, position=P[0, :n], size=LENGTH)
    message = goal(1, joints=joints, time=TIME[:2] + 2.0)
    new = build_trajectory(message, joints=joints, position=P[0, :n])
    joined = replace_at(old, jnp.array(0.5), new)
    assert joined.velocity.shape == (3, n)
    # A line of one second.
    np.testing.assert_allclose(joined.velocity[1], P[1, :n] - P[0, :n], rtol=1e-6)


def test_a_join_ends_as_its_own_segment_does_whatever_comes_after():
    """The first point has a velocity, the second has none: a cubic to the first, then a line."""
    points = list(goal(3, time=TIME + 1.0).points)
    points[1] = replace(points[1], velocities=())
    new = made(replace(goal(3), points=tuple(points)))
    np.testing.assert_array_equal(new.degree[:2], [3, 1])
    joined = join_at(made(goal(1)), jnp.array(2.1), new)
    np.testing.assert_array_equal(joined.velocity[1], np.float32(V[0]))


def test_where_no_line_follows_a_join_ends_at_rest_wherever_its_point_is():
    def total(position):
        return replace_at(old, jnp.array(2.1), replace(new, position=position)).velocity.sum()

    old, new = made(goal(1)), made(goal(1, time=TIME[:1] + 1.0))
    # The rows after the point only fill up: their places are not read as a way.
    np.testing.assert_array_equal(jax.grad(total)(new.position), 0)


def test_a_path_goes_to_joints_and_back():
    path = planned.Trajectory(
        time_s=jnp.asarray(np.append(TIME, [6.0, 6.0])),
        position_m=jnp.asarray(
            [[0, 0, -5], [0, 0, -4], [2, 0, -4], [2, -3, -4], *[[0, -5, -4]] * 3], float
        ),
        found=jnp.array(True),
    )
    joints = quickly(from_path)(path, jnp.array(0.3))
    t = jnp.asarray(WITHIN, jnp.float32)
    position, velocity = quickly(jax.vmap(planned.sample_reference, (None, 0)))(path, t)
    target = quickly(jax.vmap(sample_state, (None, 0)))(joints, t)
    # float32 of the same lines.
    np.testing.assert_allclose(target.position[:, :3], position, atol=2e-6)
    np.testing.assert_allclose(target.velocity[:, :3], velocity, atol=2e-6)
    # Up, east, south, south-west.
    at_points = [0.3, 0.0, -np.pi / 2, -3 * np.pi / 4, -3 * np.pi / 4]
    np.testing.assert_allclose(joints.position[:5, 3], at_points, atol=1e-6)
    # Put in place of something else it leads to its points: all its joints are commanded.
    joined = join_at(made(goal(1)), jnp.array(1.0), joints)
    np.testing.assert_allclose(joined.position[1:, :3], path.position_m[1:], atol=1e-6)


def stands(t, away, *, before=ResultCode.ACTIVE, speed=0.0, **limits):
    path = made(goal(1))
    now = jax.tree.map(lambda x: jnp.asarray(x[0]), sample_many(path, jnp.array([t])))
    measured = JointState(
        position=now.position + jnp.asarray(away),
        velocity=now.velocity.at[0].add(speed),
        acceleration=now.acceleration,
    )
    allowed = build_tolerances(VEHICLE_JOINTS, **limits)
    return ResultCode(int(judge(path, allowed, jnp.array(t), measured, jnp.int32(before))))


NEAR, FAR = [0.05, 0, 0, 0], [0.2, 0, 0, 0]
X = {"x": JointTolerance(position=0.1)}
LIFTED = {"x": JointTolerance(position=-1.0)}
ALL = JointTolerance(position=0.1)

STANDINGS = {
    "on the way": ((2.0, NEAR), {"path": X}, ResultCode.ACTIVE),
    "off the way": ((2.0, FAR), {"path": X}, ResultCode.PATH_TOLERANCE_VIOLATED),
    "off, nothing asked": ((2.0, FAR), {}, ResultCode.ACTIVE),
    "0 takes the default": (
        (2.0, FAR),
        {"path": {"x": JointTolerance()}, "default_path": ALL},
        ResultCode.PATH_TOLERANCE_VIOLATED,
    ),
    "-1 lifts the default": (
        (2.0, FAR),
        {"path": LIFTED, "default_path": ALL},
        ResultCode.ACTIVE,
    ),
    "speed counts": (
        (2.0, NEAR),
        {"path": {"x": JointTolerance(velocity=0.1)}, "speed": 0.2},
        ResultCode.PATH_TOLERANCE_VIOLATED,
    ),
    "a full turn is no error": ((2.0, [0, 0, 0, 2 * np.pi]), {"default_path": ALL}, 1),
    "there": ((6.0, NEAR), {"goal": X}, ResultCode.SUCCESSFUL),
    "there, path limit is over": (
        (6.0, NEAR),
        {"path": {"x": JointTolerance(position=0.01)}},
        ResultCode.SUCCESSFUL,
    ),
    "there before its time": ((5.9, NEAR), {"goal": X}, ResultCode.ACTIVE),
    "waiting for ever": ((900.0, FAR), {"goal": X}, ResultCode.ACTIVE),
    "waiting": ((7.9, FAR), {"goal": X, "goal_time_s": 2.0}, ResultCode.ACTIVE),
    "too late": (
        (8.1, FAR),
        {"goal": X, "goal_time_s": 2.0},
        ResultCode.GOAL_TOLERANCE_VIOLATED,
    ),
    "default time": (
        (8.1, FAR),
        {"goal": X, "default_goal_time_s": 2.0},
        ResultCode.GOAL_TOLERANCE_VIOLATED,
    ),
    "default time lifted": (
        (8.1, FAR),
        {"goal": X, "goal_time_s": -1.0, "default_goal_time_s": 2.0},
        ResultCode.ACTIVE,
    ),
    "an end stays": (
        (2.0, NEAR),
        {"before": ResultCode.PATH_TOLERANCE_VIOLATED},
        ResultCode.PATH_TOLERANCE_VIOLATED,
    ),
}


@pytest.mark.parametrize("case", STANDINGS)
def test_tolerances_mean_what_they_mean_in_ros(case):
    place, limits, code = STANDINGS[case]
    assert stands(*place, **limits) == code


@pytest.mark.parametrize(
    ("off", "code"), [(0.05, ResultCode.ACTIVE), (0.2, ResultCode.PATH_TOLERANCE_VIOLATED)]
)
def test_an_error_of_acceleration_is_that_against_the_reference(off, code):
    """On a quintic, where the reference has one of its own."""
    path = made(goal(5))
    now = jax.tree.map(lambda x: jnp.asarray(x[0]), sample_many(path, jnp.array([2.0])))
    assert abs(now.acceleration[0]) > 0.5
    allowed = build_tolerances(VEHICLE_JOINTS, path={"x": JointTolerance(acceleration=0.1)})
    for sign in (1, -1):
        measured = replace(now, acceleration=now.acceleration.at[0].add(sign * off))
        assert judge(path, allowed, jnp.array(2.0), measured, jnp.int32(ResultCode.ACTIVE)) == code


def test_codes_are_those_of_ros():
    assert {code.name: code.value for code in ResultCode} == {
        "ACTIVE": 1,
        "SUCCESSFUL": 0,
        "INVALID_GOAL": -1,
        "INVALID_JOINTS": -2,
        "OLD_HEADER_TIMESTAMP": -3,
        "PATH_TOLERANCE_VIOLATED": -4,
        "GOAL_TOLERANCE_VIOLATED": -5,
    }


def test_a_goal_that_asks_for_nothing_takes_all_of_the_robots_own_tolerances():
    own = JointTolerance(position=0.5, velocity=0.25, acceleration=0.125)
    given = {"x": JointTolerance(position=2.0)}
    allowed = build_tolerances(VEHICLE_JOINTS, goal=given, default_path=own, default_goal=own)
    for limits, position in ((allowed.path, 0.5), (allowed.goal, 2.0)):
        np.testing.assert_array_equal(limits.position, [position, 0.5, 0.5, 0.5])
        np.testing.assert_array_equal(limits.velocity, 0.25)
        np.testing.assert_array_equal(limits.acceleration, 0.125)


def test_a_tolerance_that_means_nothing_is_refused():
    with pytest.raises(ConfigError, match=r"goal_tolerance of joint 'x', velocity = -0.5"):
        build_tolerances(VEHICLE_JOINTS, goal={"x": JointTolerance(velocity=-0.5)})
    with pytest.raises(ConfigError, match="path_tolerance of joint 'w'"):
        build_tolerances(VEHICLE_JOINTS, path={"w": JointTolerance()})


def moved(i, **change):
    points = list(goal(3).points)
    points[i] = replace(points[i], **change)
    return replace(goal(3), points=tuple(points))


REFUSED = {
    "unknown joint": (
        replace(goal(3), joint_names=("x", "y", "z", "gripper")),
        {},
        ["robot 2", "'gripper'", "x, y, z, yaw"],
        ResultCode.INVALID_JOINTS,
    ),
    "joint twice": (replace(goal(3), joint_names=("x", "y", "x", "z")), {}, ["'x'", "twice"], -1),
    "no points": (replace(goal(3), points=()), {}, ["points", "empty"], -1),
    "time": (moved(2, time_s=1.0), {}, ["points[2].time_from_start = 1 s", "later than 1 s"], -1),
    "time below 0": (
        moved(0, time_s=-1.0),
        {},
        ["points[0].time_from_start = -1 s: must be at least 0"],
        -1,
    ),
    "NaN": (
        moved(1, positions=(0.0, np.nan, 0.0, 0.0)),
        {},
        ["points[1].positions", "'y'", "nan"],
        -1,
    ),
    "length": (
        moved(3, velocities=(0.0, 1.0)),
        {},
        ["points[3].velocities", "2 numbers for 4"],
        -1,
    ),
    "two lengths": (
        moved(3, positions=(0.0,), velocities=(0.0, 1.0)),
        {},
        ["2 faults", "points[3].positions: 1 numbers", "points[3].velocities: 2 numbers"],
        -1,
    ),
    "no positions": (moved(3, positions=()), {}, ["points[3].positions: 0 numbers for 4"], -1),
    "acceleration alone": (
        moved(1, velocities=(), accelerations=(0.0,) * 4),
        {},
        ["points[1].accelerations", "without velocities"],
        -1,
    ),
    "far start": (
        moved(0, positions=(P[0, 0] + 0.6, *P[0, 1:])),
        {"start_tolerance": 0.5},
        ["points[0]", "'x'", f"{P[0, 0] + 0.6:g}", "start tolerance 0.5"],
        -1,
    ),
    "speed of a line": (
        goal(1, time=np.array([0, 1, 1.5, 1.6, 6])),
        {"max_speed": {"y": 5.0}},
        ["points[3]", "'y'", "5 is the most"],
        -1,
    ),
    "speed of the last line": (
        goal(1, time=np.array([0, 1, 1.5, 4.0, 4.1])),
        {"max_speed": {"x": 5.0}},
        ["1 fault", "points[4]", "'x'", "5 is the most"],
        -1,
    ),
    "speed between points": (
        moved(1, velocities=(0.0, 0.0, 9.0, 0.0)),
        {"max_speed": {"z": 8.0}},
        ["points[1]", "'z'", "needs 9"],
        -1,
    ),
    "moving end": (moved(4, velocities=(0.0, 0.1, 0.0, 0.0)), {}, ["points[4]", "'y' = 0.1"], -1),
    "old": (replace(goal(3), stamp_s=3.0), {"now_s": 9.5}, ["header.stamp = 3 s", "9 s"], -3),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_followed_is_refused_by_name(case):
    message, how, words, code = REFUSED[case]
    with pytest.raises(GoalError) as caught:
        validate_goal(message, robot="2", joints=VEHICLE_JOINTS, position=P[0], **how)
    assert caught.value.code == code
    for word in ["robot 2", *words]:
        assert word in str(caught.value)


def test_only_what_may_be_left_out_is_said_to_be():
    message = moved(3, positions=(0.0,), velocities=(0.0, 1.0))
    with pytest.raises(GoalError) as caught:
        validate_goal(message, robot="2", joints=VEHICLE_JOINTS, position=P[0])
    _, positions, velocities = str(caught.value).splitlines()
    assert positions.endswith("give one for each joint_name")
    assert velocities.endswith("give one for each joint_name, or none")


def test_what_can_be_followed_is_not_refused():
    here = P[0] + [0.3, 0, 0, 2 * np.pi]
    how = {"start_tolerance": 0.4, "max_speed": dict.fromkeys(VEHICLE_JOINTS, 50.0), "now_s": 1.0}
    for degree in (1, 3, 5):
        validate_goal(goal(degree), robot="0", joints=VEHICLE_JOINTS, position=here, **how)
