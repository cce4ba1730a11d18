"""Policies inside a segment: what they know, what they keep, and that they fly as the stack."""

from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.control import stages
from angler_mjx.control.commands import BodyTwist, BodyWrench, Estimate, PoseTarget, ThrusterPwm
from angler_mjx.control.joint_trajectory import VEHICLE_JOINTS, JointTrajectory
from angler_mjx.control.laws import follow
from angler_mjx.control.stack import ControlParams
from angler_mjx.engines.lanes.engine import FusedEngine
from angler_mjx.engines.mjx import MjxEngine
from angler_mjx.engines.triton.engine import TritonEngine
from angler_mjx.errors import ConfigError
from angler_mjx.physics.step import VehicleState
from angler_mjx.sim import policy as policies
from angler_mjx.sim.aboard import Aboard
from angler_mjx.sim.policy import Known, Policy
from angler_mjx.vehicles import library, params
from angler_mjx.world import currents

from ..compiling import quickly

WORLDS, SAMPLES, EVERY = 3, 4, 5
FOLLOW = 0
"""The stage of the cascade that a policy can stand in for."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class AsTheStack(Policy):
    """The guidance of the cascade, which then enters one stage lower."""

    gains: follow.FollowGains = field(default_factory=follow.FollowGains)
    dt_s: float = field(default=0.05, metadata={"static": True})

    def reset(self, known, key):
        w, x, y, z = jnp.moveaxis(known.belief.q, -1, 0)
        return jax.vmap(follow.reset)(jnp.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))

    def act(self, carry, known, key, step):
        one = partial(follow.step, self.gains, dt=self.dt_s)
        return jax.vmap(one)(carry, known.belief, known.path)


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
class Meet(Policy):
    """Every robot goes to the middle of all, as they believe it."""

    def act(self, carry, known, key, step):
        p = known.belief.p
        middle = jnp.broadcast_to(jnp.mean(p, axis=0), p.shape)
        still = jnp.zeros_like(p)
        return carry, PoseTarget(position_m=middle, velocity_mps=still, yaw_rad=still[:, 0])


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


def draw(scenes, robots=2):
    """Worlds of two robots in open water, with keys for a policy."""
    build, members, obstacles = scenes
    scene = build(WORLDS, members=members("bluerov2") * robots, config=obstacles["none"])
    keys = jax.random.key_data(jax.random.split(jax.random.key(3), WORLDS))
    return replace(scene, worlds=replace(scene.worlds, policy_key=keys))


@pytest.fixture(scope="module")
def scene(scenes):
    return draw(scenes)


@pytest.fixture(scope="module")
def double(scenes):
    with jax.enable_x64(True):
        return draw(scenes)


def fly(engine, scene, policy, samples=SAMPLES, every=EVERY, state=None, worlds=None):
    """Final state and samples [W, samples, ...]."""
    worlds = scene.worlds if worlds is None else worlds
    if state is None:
        state = quickly(partial(FusedEngine().reset, scene.spec))(scene.fleet, worlds, policy)
    count = {"n_sample": samples, "steps_per_sample": every}
    run = quickly(partial(engine.segment, scene.spec, **count))
    return jax.device_get(run(scene.fleet, worlds, state, policy=policy))


def assert_close(ours, theirs, tolerance):
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path(ours), jax.tree.leaves(theirs), strict=True
    ):
        name = jax.tree_util.keystr(path)
        np.testing.assert_allclose(x, y, rtol=tolerance, atol=tolerance, err_msg=name)


@pytest.mark.parametrize(
    "engine",
    [
        MjxEngine(),
        FusedEngine(),
        pytest.param(
            TritonEngine(lanes=2, interpret=True),
            marks=pytest.mark.nightly(by="the fused engine in plain JAX"),
        ),
    ],
)
def test_a_policy_that_is_the_first_stage_flies_as_the_stack(double, engine):
    with jax.enable_x64(True):
        stack, stack_seen = fly(FusedEngine(), double, None)
        ours, seen = fly(engine, double, AsTheStack())
    # float64; the heading at the start comes from the attitude here.
    assert_close(ours.vehicles, stack.vehicles, 1e-9)
    assert_close(seen, stack_seen, 1e-9)
    assert_close(ours.tally, stack.tally, 1e-9)
    # The guidance of the stack stood idle; that of the policy did its work.
    assert_close(ours.policy.carry, stack.carry.stages[FOLLOW], 1e-9)
    assert np.all(np.asarray(ours.carry.stages[FOLLOW].clock_s) == 0.0)
    assert np.min(np.linalg.norm(seen.target_m[:, -1] - seen.target_m[:, 0], axis=-1)) > 0.05


@pytest.fixture(scope="module")
def dice(scene):
    return fly(FusedEngine(), scene, Dice(), every=1)


def expected(key, step, calls, shape, spread=100.0):
    wrapped = jax.random.wrap_key_data(key)
    luck = jax.random.uniform(jax.random.fold_in(wrapped, 2**32 - 1))
    noise = jax.random.uniform(jax.random.fold_in(wrapped, step), shape)
    return 1500.0 + calls + luck + spread * noise


def test_keys_are_of_world_and_step_and_the_carry_counts(scene, dice):
    after, seen = dice
    for world, key in enumerate(scene.worlds.policy_key):
        for step in range(SAMPLES):
            signals = expected(key, step, step, seen.pwm_us.shape[2:])
            np.testing.assert_allclose(seen.pwm_us[world, step], signals, rtol=1e-6)
    np.testing.assert_array_equal(after.policy.carry[0], SAMPLES)
    assert after.policy.command is None


def test_segments_go_on_with_the_carry_and_worlds_are_their_own(scene, dice):
    after, seen = dice
    half, first = fly(FusedEngine(), scene, Dice(), samples=SAMPLES // 2, every=1)
    end, second = fly(FusedEngine(), scene, Dice(), samples=SAMPLES // 2, every=1, state=half)
    both = np.concatenate([first.pwm_us, second.pwm_us], axis=1)
    np.testing.assert_array_equal(both, seen.pwm_us)
    np.testing.assert_array_equal(end.vehicles.p, after.vehicles.p)
    worlds = jax.tree.map(lambda leaf: leaf[1:2], scene.worlds)
    _, alone = fly(FusedEngine(), scene, Dice(), every=1, worlds=worlds)
    np.testing.assert_array_equal(alone.pwm_us[0], seen.pwm_us[1])


@pytest.mark.parametrize(
    "engine",
    [
        FusedEngine(),
        pytest.param(
            TritonEngine(lanes=2, interpret=True),
            marks=pytest.mark.nightly(by="the fused engine in plain JAX"),
        ),
    ],
)
def test_a_command_holds_for_its_period(scene, engine):
    after, seen = fly(engine, scene, Dice(period=3), samples=5, every=1)
    key = scene.worlds.policy_key[2]
    for step, (acted, calls) in enumerate([(0, 0), (0, 0), (0, 0), (3, 1), (3, 1)]):
        signals = expected(key, acted, calls, seen.pwm_us.shape[2:])
        np.testing.assert_allclose(seen.pwm_us[2, step], signals, rtol=1e-6)
    np.testing.assert_array_equal(after.policy.carry[0], 2)


def test_robots_of_a_world_see_each_other(scene):
    _, seen = fly(FusedEngine(), scene, Meet(), every=1)
    middle = np.mean(seen.p, axis=2, keepdims=True)
    np.testing.assert_allclose(seen.target_m, np.broadcast_to(middle, seen.p.shape), rtol=1e-6)
    # Each world has another middle.
    assert np.ptp(middle[:, 0, 0, 0]) > 0.01


def test_a_command_from_outside_stands_in_for_the_policy(scene):
    policy = Dice()
    state = quickly(partial(FusedEngine().reset, scene.spec))(scene.fleet, scene.worlds, policy)
    signals = jnp.full(
        (*scene.worlds.variant.shape, scene.fleet.control.vehicle.B.shape[-1]), 1501.0
    )
    step = quickly(partial(FusedEngine().control_step, scene.spec))
    after, sample = step(scene.fleet, scene.worlds, state, ThrusterPwm(pwm_us=signals), policy)
    np.testing.assert_array_equal(sample.pwm_us, signals)
    np.testing.assert_array_equal(after.policy.carry[0], 0)


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
def test_what_cannot_be_flown_is_refused_before_the_flight(scene, policy, message):
    reset = partial(FusedEngine().reset, scene.spec)
    with pytest.raises(ConfigError, match=message):
        jax.eval_shape(reset, scene.fleet, scene.worlds, policy)


def test_every_level_is_taken(scene):
    reset = partial(FusedEngine().reset, scene.spec)
    for command in (joints(2), BodyWrench(tau=jnp.zeros((2, 6)))):
        state = jax.eval_shape(reset, scene.fleet, scene.worlds, Gives(what=command, period=2))
        assert type(state.policy.command) is type(command)


@pytest.mark.parametrize(("signals", "taken"), [(8, True), (6, False)])
def test_signals_are_as_many_as_the_thrusters(signals, taken):
    """Eight on a Heavy; as many as a wrench has components are too few."""
    heavy = params.build(library.load("bluerov2_heavy"), "wu2018", 16.0)
    two = jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), heavy)
    still = jnp.zeros((2, 3))
    knows = Known(
        belief=Estimate(p=still, q=jnp.zeros((2, 4)), nu=jnp.zeros((2, 6))),
        time_s=jnp.zeros(()),
        goal_m=still,
        path=(),
        params=ControlParams(vehicle=two, allocation=(), cruise_speed_mps=jnp.ones(2)),
    )
    policy = Gives(what=ThrusterPwm(pwm_us=jnp.zeros((2, signals))))
    begin = partial(policies.begin, policy, stages.named("cascade"))
    key = jax.random.key_data(jax.random.key(0))
    if taken:
        assert begin(key, knows).carry == ()
    else:
        with pytest.raises(
            ConfigError, match=r"pwm_us has the shape \[1, 2, 6\]: must be \[1, 2, 8\]"
        ):
            begin(key, knows)


@pytest.mark.parametrize("number", [0, 1, 7])
def test_a_policy_is_told_the_time_and_the_current_of_then(scene, number):
    world = jax.tree.map(lambda leaf: leaf[1], scene.worlds)
    start = world.environment.start_m
    vehicles = VehicleState(
        p=start,
        q=jnp.tile(jnp.array([1.0, 0, 0, 0]), (len(start), 1)),
        nu=jnp.zeros((len(start), 6)),
        force_before=jnp.zeros((len(start), 6)),
        thrust=jnp.zeros((len(start), 6)),
    )
    here = Aboard(
        spec=scene.spec, policy=Meet(), world=world, number=jnp.asarray(number), vehicles=vehicles
    )
    known = here.known(None)
    # Steps of 50 ms.
    assert float(known.time_s) == pytest.approx(0.05 * number)
    flow = [
        currents.velocity(world.environment.current, p, jnp.asarray(0.05 * number)) for p in start
    ]
    np.testing.assert_allclose(known.belief.flow, flow, atol=1e-6)  # float32
    np.testing.assert_array_equal(known.goal_m, world.environment.goal_m)


def test_worlds_without_keys_are_refused(scene):
    bare = replace(scene.worlds, policy_key=None)
    with pytest.raises(ConfigError, match="policy Meet: the worlds were drawn without keys"):
        jax.eval_shape(partial(FusedEngine().reset, scene.spec), scene.fleet, bare, Meet())


@pytest.mark.nightly(by="engines/test_gradients.py")
def test_parameters_have_derivatives(double):
    """A policy's numbers are arguments; the slope is that of a difference."""
    with jax.enable_x64(True):
        engine, spec = FusedEngine(), double.spec
        start = quickly(partial(engine.reset, spec))(double.fleet, double.worlds, Ahead())

        def cost(speed):
            policy = Ahead(speed_mps=speed)
            run = partial(engine.segment, spec, n_sample=1, steps_per_sample=5)
            after, _ = run(double.fleet, double.worlds, start, policy=policy)
            return jnp.sum(after.vehicles.nu[..., 0] ** 2)

        speed, step = jnp.asarray(0.3), 1e-5
        both = quickly(jax.value_and_grad(cost))
        slope = both(speed)[1]
        difference = (both(speed + step)[0] - both(speed - step)[0]) / (2 * step)
    assert abs(difference) > 1e-4
    np.testing.assert_allclose(slope, difference, rtol=1e-5)
