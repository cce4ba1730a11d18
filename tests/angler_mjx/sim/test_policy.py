"""Policies inside a segment: what they know, what they keep, and that they fly as the stack."""

from dataclasses import dataclass, field, replace
from functools import cache, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import stages
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    Estimate,
    PoseTarget,
    ThrusterPwm,
)
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, JointTrajectory
from angler_mjx.robot.control.laws import follow
from angler_mjx.robot.control.stack import ControlParams
from angler_mjx.robot.vehicles import library, params
from angler_mjx.sim import policy as policies
from angler_mjx.sim import robot
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.engines.mjx import MjxEngine
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy, PolicyInput
from angler_mjx.sim.world_context import WorldContext
from angler_mjx.world import currents

from ..compiling import quickly

WORLDS, SAMPLES, EVERY = 3, 4, 5
MJX, FUSED = MjxEngine(), FusedEngine()
KERNELS = pytest.param(
    CudaEngine(block=2, interpret=True),
    marks=pytest.mark.nightly(by="the fused engine in plain JAX"),
)
FOLLOW = 0
"""The stage of the cascade that a policy can stand in for."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Guide(Policy):
    """The guidance of the cascade, which then enters one stage lower.

    Or every robot goes to the middle of all, as they believe it: a number, so that both are one
    program.
    """

    meet: Any = False
    gains: follow.FollowGains = field(default_factory=follow.FollowGains)
    dt_s: float = field(default=0.05, metadata={"static": True})

    def reset(self, known, key):
        w, x, y, z = jnp.moveaxis(known.belief.q, -1, 0)
        return jax.vmap(follow.reset)(jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    def act(self, carry, known, key, step):
        one = partial(follow.step, self.gains, dt=self.dt_s)
        carry, alone = jax.vmap(one)(carry, known.belief, known.path)
        p = known.belief.p
        middle, still = jnp.broadcast_to(jnp.mean(p, axis=0), p.shape), jnp.zeros_like(p)
        together = PoseTarget(position_m=middle, velocity_mps=still, yaw_rad=still[:, 0])
        return carry, jax.tree.map(partial(jnp.where, self.meet), together, alone)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Dice(Policy):
    """Random signals, and the number of calls as their mean."""

    spread_us: float = 100.0
    period: int = field(default=1, metadata={"static": True})

    def reset(self, known, key):
        return jnp.zeros((), jnp.int32), jax.random.uniform(key)

    def act(self, carry, known, key, step):
        calls, luck = carry
        shape = (*known.goal_m.shape[:1], known.params.vehicle.B.shape[-1])
        pwm = 1500.0 + calls + luck + self.spread_us * jax.random.uniform(key, shape)
        return (calls + 1, luck), ThrusterPwm(pwm_us=pwm)


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Ahead(Policy):
    """A speed ahead, in the body's frame."""

    speed_mps: Any = 0.3

    def act(self, carry, known, key, step):
        ahead = jnp.eye(6)[0] * self.speed_mps
        return carry, BodyTwist(nu=jnp.broadcast_to(ahead, known.belief.nu.shape))


@dataclass(frozen=True, kw_only=True)
class Gives(Policy):
    """Whatever it is told to."""

    what: Any
    period: int = 1
    after: Any = ()

    def act(self, carry, known, key, step):
        return self.after, self.what


jax.tree_util.register_dataclass(Gives, data_fields=["what", "after"], meta_fields=["period"])


NO_COMMAND = Estimate(p=jnp.zeros((2, 3)), q=jnp.zeros((2, 4)), nu=jnp.zeros((2, 6)))


@pytest.fixture(scope="module", autouse=True)
def in_double():
    """All of it in float64."""
    with jax.enable_x64(True):
        yield


@pytest.fixture(scope="module")
def scene(scenes, in_double):
    """Worlds of two robots in open water, with keys for a policy."""
    build, members, obstacles = scenes
    drawn = build(WORLDS, members=members("bluerov2") * 2, config=obstacles["none"])
    keys = jax.random.key_data(jax.random.split(jax.random.key(3), WORLDS))
    return replace(drawn, worlds=replace(drawn.worlds, policy_key=keys))


@pytest.fixture(scope="module")
def fly(scene):
    """A function (engine, policy) -> final state and samples [W, samples, ...].

    Programs are kept: other worlds, other numbers in a policy and later segments compile nothing.
    """
    reset = quickly(partial(FUSED.reset, scene.spec))

    @cache
    def segment(engine, samples, every):
        count = {"n_sample": samples, "steps_per_sample": every}
        return quickly(partial(engine.segment, scene.spec, **count))

    def run(engine, policy, samples=SAMPLES, every=EVERY, state=None, worlds=scene.worlds):
        if state is None:
            state = jax.device_get(reset(scene.fleet, worlds, policy))
        after = segment(engine, samples, every)(scene.fleet, worlds, state, policy=policy)
        return jax.device_get(after)

    return run


def assert_close(ours, theirs, tolerance):
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path(ours), jax.tree.leaves(theirs), strict=True
    ):
        name = jax.tree_util.keystr(path)
        np.testing.assert_allclose(x, y, rtol=tolerance, atol=tolerance, err_msg=name)


@pytest.fixture(scope="module")
def guided(fly):
    """The flight of `Guide`: every step is a sample."""
    return fly(FUSED, Guide(), SAMPLES * EVERY, 1)


def test_a_policy_that_is_the_first_stage_flies_as_the_stack(scene, guided):
    """Given the same states, the whole stack follows the paths with the same targets and signals.

    So the flights are the same: the thrusters move the vehicles (`engines/test_fused`).
    """
    after, seen = guided

    decide = jax.vmap(jax.vmap(partial(robot.run_controllers, scene.spec, flow=None)))
    begin = jax.vmap(jax.vmap(partial(robot.reset_controllers, scene.spec)))

    @quickly
    def by_stack(worlds, seen):
        known = Estimate(p=seen.p, q=seen.q, nu=seen.nu)
        known = jax.tree.map(lambda leaf: jnp.moveaxis(leaf, 1, 0), known)

        def one(carry, now):
            carry, target_m, pwm = decide(worlds.control, carry, now, worlds.path)
            return carry, (target_m, pwm.pwm_us)

        first = jax.tree.map(lambda leaf: leaf[0], known)
        return jax.lax.scan(one, begin(first, worlds.environment.start_yaw_rad), known)

    carry, (target_m, pwm_us) = by_stack(scene.equipped, seen)
    # float64; the heading at the start comes from the attitude here.
    np.testing.assert_allclose(np.moveaxis(seen.target_m, 1, 0), target_m, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(np.moveaxis(seen.pwm_us, 1, 0), pwm_us, rtol=1e-9, atol=1e-9)
    # The guidance of the stack stood idle; that of the policy did its work.
    assert_close(after.policy.carry, carry.stages[FOLLOW], 1e-9)
    assert_close(after.carry.stages[FOLLOW + 1 :], carry.stages[FOLLOW + 1 :], 1e-9)
    assert after.policy.command is None
    assert np.all(after.carry.stages[FOLLOW].clock_s == 0.0)
    assert np.min(np.linalg.norm(seen.target_m[:, -1] - seen.target_m[:, 0], axis=-1)) > 0.05
    assert np.ptp(seen.pwm_us, axis=1).max() > 10.0


@pytest.mark.nightly(by="the fused engine here, and sim/test_senses.py, where mjx flies a policy")
@pytest.mark.parametrize("engine", [MJX, CudaEngine(block=2, interpret=True)])
def test_every_engine_flies_it_alike(fly, guided, engine):
    for ours, theirs in zip(fly(engine, Guide(), SAMPLES * EVERY, 1), guided, strict=True):
        assert_close(ours, theirs, 1e-9)


def test_robots_of_a_world_see_each_other(fly):
    _, seen = fly(FUSED, Guide(meet=True), SAMPLES * EVERY, 1)
    middle = np.mean(seen.p, axis=2, keepdims=True)
    np.testing.assert_allclose(seen.target_m, np.broadcast_to(middle, seen.p.shape), rtol=1e-12)
    # Each world has another middle, and each time.
    assert np.ptp(middle[:, 0, 0, 0]) > 0.01
    assert np.all(np.linalg.norm(middle[:, -1] - middle[:, 1], axis=-1) > 1e-4)


PERIOD, PARTS, STEPS = 3, 3, 2
"""Commands hold for three steps; there are three segments of two steps."""


@pytest.fixture(scope="module")
def throw(fly):
    """A function (engine, worlds) -> final state, signals and places of all six steps."""

    def run(engine, worlds):
        state, signals, places = None, [], []
        for _ in range(PARTS):
            state, seen = fly(engine, Dice(period=PERIOD), STEPS, 1, state, worlds)
            signals.append(seen.pwm_us)
            places.append(seen.p)
        return state, np.concatenate(signals, axis=1), np.concatenate(places, axis=1)

    return run


@pytest.fixture(scope="module")
def dice(throw, scene):
    return throw(FUSED, scene.worlds)


def expected(key, step, calls, shape, spread=100.0):
    wrapped = jax.random.wrap_key_data(key)
    luck = jax.random.uniform(jax.random.fold_in(wrapped, 2**32 - 1))
    noise = jax.random.uniform(jax.random.fold_in(wrapped, step), shape)
    return 1500.0 + calls + luck + spread * noise


@pytest.mark.parametrize("engine", [FUSED, KERNELS])
def test_a_command_holds_for_its_period_and_the_carry_counts_over_segments(
    engine, scene, throw, dice
):
    """Keys are of world and step; a period ends in the middle of a segment, as one begins."""
    after, signals, _ = dice if engine is FUSED else throw(engine, scene.worlds)
    for world, key in enumerate(scene.worlds.policy_key):
        for step in range(PARTS * STEPS):
            calls, since = divmod(step, PERIOD)
            wanted = expected(key, step - since, calls, signals.shape[2:])
            np.testing.assert_allclose(signals[world, step], wanted, rtol=1e-12)
    np.testing.assert_array_equal(after.policy.carry[0], 2)


def test_worlds_are_their_own(scene, throw, dice):
    """In another place, beside others: each does to the last bit what it did."""
    order = np.array([2, 1, 1])
    moved = jax.tree.map(lambda leaf: np.asarray(leaf)[order], scene.worlds)
    for ours, before in zip(throw(FUSED, moved)[1:], dice[1:], strict=True):
        np.testing.assert_array_equal(ours, before[order])
    assert len(np.unique(dice[1][:, 0, 0, 0])) == WORLDS


def joints(robots):
    """A JointTrajectory of two points for each robot."""
    table = jnp.zeros((robots, 2, len(VEHICLE_JOINTS)))
    return JointTrajectory(
        joints=VEHICLE_JOINTS,
        time_s=jnp.broadcast_to(jnp.array([0.0, 1.0]), (robots, 2)),
        position=table,
        velocity=table,
        acceleration=table,
        degree=jnp.ones((robots, 2), jnp.int32),
        commanded=jnp.ones((robots, len(VEHICLE_JOINTS)), bool),
    )


@pytest.fixture(scope="module")
def begin(in_double):
    """A function: the memory that the controllers of two Heavies give a policy at t = 0."""
    heavy = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 16.0)
    two = jax.tree.map(lambda leaf: np.stack([leaf, leaf]), heavy)
    still = np.zeros((2, 3))
    information = PolicyInput(
        belief=Estimate(p=still, q=np.zeros((2, 4)), nu=np.zeros((2, 6))),
        time_s=np.zeros(()),
        goal_m=still,
        path=(),
        params=ControlParams(vehicle=two, allocation=(), cruise_speed_mps=np.ones(2)),
    )
    key = jax.random.key_data(jax.random.key(0))
    return lambda policy: policies.begin_policy(
        policy, stages.find_controller("cascade"), key, information
    )


@pytest.mark.parametrize(
    ("policy", "message"),
    [
        (Gives(what=NO_COMMAND), "policy Gives: command Estimate: no stage of follow, pose"),
        (
            Gives(what=BodyWrench(tau=jnp.zeros((3, 6)))),
            r"policy Gives: .*tau has the shape \[1, 3, 6\]: must be \[1, 2, 6\]",
        ),
        (Gives(what=BodyWrench(tau=jnp.zeros((2, 6))), period=0), "period = 0"),
        (Gives(what=BodyWrench(tau=jnp.zeros((2, 6))), after=jnp.zeros(3)), "memory of other"),
    ],
)
def test_what_cannot_be_flown_is_refused_before_the_flight(begin, policy, message):
    with pytest.raises(ConfigError, match=message):
        begin(policy)


def test_an_engine_refuses_when_it_is_reset(scene):
    reset = partial(FUSED.reset, scene.spec)
    with pytest.raises(ConfigError, match="policy Gives: command Estimate"):
        jax.eval_shape(reset, scene.fleet, scene.worlds, Gives(what=NO_COMMAND))


def test_every_level_is_taken(begin):
    for command in (joints(2), BodyWrench(tau=jnp.zeros((2, 6)))):
        assert type(begin(Gives(what=command, period=2)).command) is type(command)


@pytest.mark.parametrize(("signals", "taken"), [(8, True), (6, False)])
def test_signals_are_as_many_as_the_thrusters(begin, signals, taken):
    """Eight on a Heavy; as many as a wrench has components are too few."""
    policy = Gives(what=ThrusterPwm(pwm_us=jnp.zeros((2, signals))))
    if taken:
        assert begin(policy).carry == ()
    else:
        with pytest.raises(
            ConfigError, match=r"pwm_us has the shape \[1, 2, 6\]: must be \[1, 2, 8\]"
        ):
            begin(policy)


@pytest.fixture(scope="module")
def told(scene):
    """A function: the time, currents and goals that a policy is told, and where its robots are."""
    world = jax.tree.map(lambda leaf: np.asarray(leaf)[1], scene.equipped)
    start = world.environment.start_m
    vehicles = VehicleState(
        p=start,
        q=np.tile(np.array([1.0, 0, 0, 0]), (len(start), 1)),
        nu=np.zeros((len(start), 6)),
        force_before=np.zeros((len(start), 6)),
        thrust=np.zeros((len(start), 6)),
    )

    @quickly
    def known(number):
        here = WorldContext(
            spec=scene.spec, policy=Guide(), world=world, number=number, vehicles=vehicles
        )
        known = here.build_policy_input(None)
        return known.time_s, known.belief.flow, known.goal_m

    return world.environment, known


@pytest.mark.parametrize("number", [0, 1, 7])
def test_a_policy_is_told_the_time_and_the_current_of_then(told, number):
    environment, known = told
    time_s, flow, goal_m = known(np.int32(number))
    # Steps of 50 ms.
    assert float(time_s) == pytest.approx(0.05 * number)
    there = quickly(jax.vmap(currents.velocity, (None, 0, None)))
    wanted = there(environment.current, environment.start_m, 0.05 * number)
    np.testing.assert_allclose(flow, wanted, atol=1e-12)
    np.testing.assert_array_equal(goal_m, environment.goal_m)


def test_worlds_without_keys_are_refused(scene):
    bare = replace(scene.worlds, policy_key=None)
    with pytest.raises(ConfigError, match="policy Guide: the worlds were drawn without keys"):
        jax.eval_shape(partial(FUSED.reset, scene.spec), scene.fleet, bare, Guide())


@pytest.mark.nightly(by="engines/test_gradients.py")
def test_parameters_have_derivatives(scene):
    """A policy's numbers are arguments; the slope is that of a difference."""
    start = quickly(partial(FUSED.reset, scene.spec))(scene.fleet, scene.worlds, Ahead())

    def cost(speed):
        policy = Ahead(speed_mps=speed)
        run = partial(FUSED.segment, scene.spec, n_sample=1, steps_per_sample=5)
        after, _ = run(scene.fleet, scene.worlds, start, policy=policy)
        return jnp.sum(after.vehicles.nu[..., 0] ** 2)

    speed, step = jnp.asarray(0.3), 1e-5
    both = quickly(jax.value_and_grad(cost))
    slope = both(speed)[1]
    difference = (both(speed + step)[0] - both(speed - step)[0]) / (2 * step)
    assert abs(difference) > 1e-4
    np.testing.assert_allclose(slope, difference, rtol=1e-5)
