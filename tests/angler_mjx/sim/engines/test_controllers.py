"""Every stack that has a name, in closed loop in the simulator, as both engines decide, in float64.

And what else can drive the controllers: all kinds of commands, on lanes and in kernels.
"""

from dataclasses import dataclass, replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import lanes
from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import plans, stack, stages
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    PoseTarget,
    ThrusterPwm,
    as_tracking,
)
from angler_mjx.robot.control.commands.joint_trajectory import from_path
from angler_mjx.sim import fleet, robot, step
from angler_mjx.sim.engines.cuda.kernels import Kernels
from angler_mjx.sim.engines.cuda.launch import LaunchShape
from angler_mjx.sim.engines.cuda.packed_state import PackedState
from angler_mjx.sim.engines.cuda.segment import Segment
from angler_mjx.sim.engines.cuda.tile import Tile
from angler_mjx.sim.engines.lanes.engine import FusedEngine, SceneBatch
from angler_mjx.sim.engines.lanes.layout import (
    broadcast_lanes,
    lane_state_of,
    scene_of,
    to_arrays,
    to_lanes,
)
from angler_mjx.sim.policy import Policy, PolicyMemory
from angler_mjx.sim.state import Outcome
from angler_mjx.sim.step import DECIDE
from angler_mjx.world import currents

from ...compiling import quickly

WORLDS, PARITY, LONGEST = 3, 40, 880
"""Worlds; control steps in which engines are compared, 2 s; and in which robots must arrive, 44 s.
Paths take up to 25 s."""


@pytest.fixture(scope="module")
def scene(scenes):
    """Heavies of all parameter sets in moving water without anything to hit."""
    build, members, obstacles = scenes
    with jax.enable_x64(True):
        made = build(WORLDS, members=members("bluerov2_heavy"), config=obstacles["none"])
        environment = made.worlds.environment
        grid = replace(environment.grid, occupied=jnp.zeros_like(environment.grid.occupied))
        worlds = replace(made.worlds, environment=replace(environment, grid=grid))
    return replace(made, worlds=worlds)


@pytest.fixture(scope="module")
def at_rest(scene, engines_by_name):
    """The state at t = 0 with the memory of any controllers."""
    with jax.enable_x64(True):
        first = quickly(partial(engines_by_name["fused"].reset, scene.spec))(
            scene.fleet, scene.worlds
        )
    # In numpy: what begins a flight has the types of what goes on with it, and is compiled once.
    first = jax.device_get(first)
    yaw = np.asarray(scene.worlds.environment.start_yaw_rad)

    def start(spec):
        begin = quickly(jax.vmap(jax.vmap(partial(robot.reset_controllers, spec))))
        return replace(first, carry=jax.device_get(begin(first.vehicles, yaw)))

    return start


def spec_of(scene, names, gains=None):
    made, numbers = stages.build_stack(names, gains or {})
    return replace(scene.spec, stages=made, gains=numbers)


def on_lanes(spec, kinds, worlds, state):
    """Memory and signals of the controllers, as the fused engine has them decide."""
    scene, moving = scene_of(kinds, worlds), lane_state_of(kinds, state)
    (given,), (robots,) = scene.groups, moving.groups
    t = time_of(spec, state)
    batch = SceneBatch(spec=spec, scene=scene, t=t, shape=scene.shape)
    done = step.decide_commands(
        batch,
        step.DecideInput(
            estimate=robots.vehicle,
            memory=robots.memory,
            flow=step.select_flow(batch, lambda: batch.current, robots.vehicle),
            params=given.params,
            command=plans.check_plan(spec.stages, given.path),
        ),
    )
    like = robots.vehicle.p[0]
    given_back = (done.output().memory, done.record()["pwm_us"])
    return to_arrays(jax.tree.map(lambda leaf: broadcast_lanes(leaf, like), given_back), 2)


def mapped(spec, kinds, worlds, state):
    """The same as the mjx engine has them decide."""

    def one(world, vehicles, carry):
        flow = jax.vmap(currents.velocity, (None, 0, None))(
            world.environment.current, vehicles.p, time_of(spec, state)
        )
        decided = jax.vmap(partial(robot.run_controllers, spec))(
            world.control, carry, vehicles, world.path, flow
        )
        return decided[0], decided[2].pwm_us

    return jax.vmap(one)(fleet.add_parameters(kinds, worlds), state.vehicles, state.carry)


def time_of(spec, state):
    return state.step[0].astype(state.vehicles.p.dtype) * spec.control_dt_s


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Counts(Policy):
    """Counts how often it is asked."""

    def act(self, carry, known, key, step):
        return carry + 1, ThrusterPwm(pwm_us=jnp.full(known.goal_m.shape[:1], 1500.0))


UNASKED = PolicyMemory(carry=np.zeros(WORLDS, np.int32), command=None)


@pytest.fixture(scope="module")
def flown(scene, at_rest, engines_by_name):
    """A function (controller, engine, steps) -> what is seen of `PARITY` steps, and the end.

    Seen are the states before, the memory after and the signals, [PARITY] leading. The engine takes
    the signals of the controllers as a command; how the two are put together is compared in
    `test_fused` and `sim/test_senses`. The signals stand in for a policy's.
    """
    deciding = {"fused": on_lanes, "mjx": mapped}
    signals = stack.ControlMemory(stages=(), realised=None)

    def one(spec, engine, kinds, worlds, state, _):
        carry, pwm = deciding[engine](spec, kinds, worlds, state)
        alone, command = replace(state, carry=signals), ThrusterPwm(pwm_us=pwm)
        after, sample = engines_by_name[engine].control_step(
            scene.spec, kinds, worlds, alone, command, Counts()
        )
        return replace(after, carry=carry), (state, carry, pwm, sample.pwm_us)

    @cache
    def fly(name, engine, steps):
        with jax.enable_x64(True):
            spec = spec_of(scene, stages.CONTROLLERS[name])

            @quickly
            def some(kinds, worlds, state):
                step = partial(one, spec, engine, kinds, worlds)
                return jax.lax.scan(step, state, length=PARITY)

            state, parts = replace(at_rest(spec), policy=UNASKED), []
            while len(parts) < steps // PARITY:
                state, (*seen, sent) = jax.device_get(some(scene.fleet, scene.worlds, state))
                np.testing.assert_array_equal(sent, seen[-1])
                parts.append(seen)
                if np.all(state.tally.outcome != Outcome.RUNNING):
                    break
            return parts[0], state

    return fly


def assert_close(ours, theirs, tolerance):
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path(ours), jax.tree.leaves(theirs), strict=True
    ):
        name = jax.tree_util.keystr(path)
        if jnp.issubdtype(y.dtype, jnp.floating):
            np.testing.assert_allclose(x, y, rtol=tolerance, atol=tolerance, err_msg=name)
        else:
            np.testing.assert_array_equal(x, y, err_msg=name)


DAILY = ("ardusub",)
"""Flown here in every run of the tests; on both engines the cascade is in `test_fused`, tracking in
`sim/test_senses`."""
ELSEWHERE = "; the cascade by test_fused.py"


def controllers(by, daily=DAILY):
    """All, but those of a day alone by night; ``by`` proves the others in small."""
    return [
        name if name in daily else pytest.param(name, marks=pytest.mark.nightly(by=by))
        for name in stages.CONTROLLERS
    ]


@pytest.mark.parametrize("name", controllers(by=f"control/laws/test_lanes.py{ELSEWHERE}"))
def test_both_engines_decide_alike_along_a_flight(name, scene, flown):
    seen, _ = flown(name, "fused", LONGEST)
    states, *ours = seen
    with jax.enable_x64(True):
        decide = jax.vmap(
            partial(mapped, spec_of(scene, stages.CONTROLLERS[name])), (None, None, 0)
        )
        theirs = quickly(decide)(scene.fleet, scene.worlds, states)
    # float64 leaves rounding no room; found is 1e-12.
    assert_close(tuple(ours), theirs, 1e-9)
    assert np.abs(np.asarray(states.vehicles.nu[..., :3])).max() > 0.1
    assert np.ptp(ours[1], axis=0).max() > 10.0


BY_DECISIONS = "test_both_engines_decide_alike_along_a_flight, and test_fused.py for what they move"


@pytest.mark.parametrize("name", controllers(by=BY_DECISIONS, daily=()))
def test_both_engines_fly_it_alike(name, flown):
    ours, _ = flown(name, "fused", LONGEST)
    theirs, _ = flown(name, "mjx", PARITY)
    # As for the cascade: float64 leaves rounding no room; found is 1e-12.
    assert_close(ours, theirs, 1e-9)
    assert np.abs(ours[0].vehicles.nu[..., :3]).max() > 0.1


@pytest.mark.parametrize("name", stages.CONTROLLERS)
def test_memory_comes_out_as_it_went_in(name, scene, at_rest):
    """Traced, not computed: so a segment of it can be put together."""
    spec = spec_of(scene, stages.CONTROLLERS[name])
    with jax.enable_x64(True):
        state = at_rest(spec)
        after, pwm = jax.eval_shape(partial(on_lanes, spec), scene.fleet, scene.worlds, state)
    assert_alike(after, state.carry)
    assert pwm.shape == (WORLDS, 1, 8)


@pytest.mark.parametrize("name", controllers(by="test_memory_comes_out_as_it_went_in", daily=()))
def test_a_segment_of_it_can_be_put_together(name, scene, at_rest, engines_by_name):
    """Traced, not computed: every leaf of the state comes out as it went in."""
    spec = spec_of(scene, stages.CONTROLLERS[name])
    with jax.enable_x64(True):
        state = at_rest(spec)
        run = partial(engines_by_name["fused"].segment, spec, n_sample=1, steps_per_sample=2)
        after, sample = jax.eval_shape(run, scene.fleet, scene.worlds, state)
    assert_alike(after, state)
    assert sample.target_m.shape == (WORLDS, 1, 1, 3)


def assert_alike(ours, theirs):
    """The same structure, shapes and types."""
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    for x, y in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert (x.shape, x.dtype) == (y.shape, y.dtype)


@pytest.mark.parametrize("name", controllers(by=f"control/laws/test_closed_loops.py{ELSEWHERE}"))
def test_it_brings_robots_to_their_goals(name, flown):
    _, end = flown(name, "fused", LONGEST)
    assert np.all(np.asarray(end.tally.outcome) == Outcome.REACHED), np.asarray(end.tally.outcome)
    assert np.asarray(end.tally.path_length_m).min() > 3.0


def test_a_command_from_outside_stands_in_for_the_policy(flown):
    """The signals of the flights are those that were given; nobody asked the policy."""
    _, end = flown(DAILY[0], "fused", LONGEST)
    assert end.step[0] > PARITY
    np.testing.assert_array_equal(end.policy.carry, 0)


def commands(scene, state):
    """One of each kind for every robot."""
    environment = scene.worlds.environment
    yaw = np.asarray(environment.start_yaw_rad)
    random = np.random.default_rng(3)

    def some(*tail):
        return random.normal(size=(*yaw.shape, *tail))

    pose = PoseTarget(
        position_m=state.vehicles.p + some(3), velocity_mps=0.1 * some(3), yaw_rad=some()
    )
    return {
        "path": scene.worlds.path,
        "joints": quickly(jax.vmap(jax.vmap(from_path)))(scene.worlds.path, yaw),
        "pose": pose,
        "tracking": quickly(jax.vmap(jax.vmap(as_tracking)))(pose),
        "twist": BodyTwist(nu=0.3 * some(6)),
        "wrench": BodyWrench(tau=20.0 * some(6)),
        "signals": ThrusterPwm(pwm_us=1500 + 100 * some(8)),
    }


@pytest.fixture(scope="module")
def told(scene, at_rest):
    """One of each kind of command, at rest."""
    with jax.enable_x64(True):
        return commands(scene, at_rest(scene.spec))


KINDS = ["path", "joints", "pose", "tracking", "twist", "wrench", "signals"]


@pytest.mark.parametrize("kind", KINDS)
def test_lanes_take_every_kind_of_command(kind, scene, at_rest, told):
    """What the fused engine does with a command is what the mjx engine does with it."""
    with jax.enable_x64(True):
        state, decide = at_rest(scene.spec), partial(robot.run_controllers, scene.spec, flow=None)
        moving = state.carry, state.vehicles, told[kind]
        expected = quickly(jax.vmap(jax.vmap(decide)))(scene.equipped.control, *moving)
        given = scene_of(scene.fleet, scene.worlds).groups[0].params
        found = to_arrays(lanes.apply(decide, given, *to_lanes(moving, 2)), 2)
    for x, y in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
        # The same numbers in another order of adding; signals are of 1500 us.
        np.testing.assert_allclose(np.broadcast_to(x, y.shape), y, rtol=1e-12, atol=1e-9)


# The cascade's are lowered elsewhere, with the other phases; the others have no operation that
# these have not.
@pytest.mark.parametrize("name", ["los", "tracking", "ismc", "aitsm", "ardusub"])
@pytest.mark.usefixtures("as_if_on_an_h200")
def test_the_kernel_of_every_controller_lowers_for_cuda(name, scene, at_rest, told):
    spec = spec_of(scene, stages.CONTROLLERS[name])
    with jax.enable_x64(True):
        # The command that reads most from memory: tables of numbers and of whole numbers.
        given = scene.worlds, at_rest(spec), told["path" if name == "los" else "joints"]
        worlds, state, command = jax.tree.map(single, given)

    def decide(worlds, state, command):
        part = Segment(
            Tile(jax.tree.map(single, scene.fleet), worlds),
            PackedState.of(state, 1, None),
            1,
            1,
            command,
            None,
        )
        kernels = Kernels(LaunchShape(block=1), spec, part)
        start = np.zeros(1, np.int32)
        return kernels.run_phase(DECIDE, part.tile.groups[0], start, start, part.start)

    traced = jax.jit(decide).trace(worlds, state, command)
    text = traced.lower(lowering_platforms=("cuda",)).as_text()
    assert text.count("__gpu$xla.gpu.ptx") == 1


def single(x):
    return np.asarray(x, np.float32) if jnp.issubdtype(x.dtype, jnp.floating) else x


def test_a_command_that_the_controllers_do_not_take_is_refused(scene, at_rest, told):
    spec = spec_of(scene, stages.CONTROLLERS["ardusub"])
    with jax.enable_x64(True):
        state = at_rest(spec)
        step = partial(FusedEngine().control_step, spec)
        with pytest.raises(ConfigError, match="BodyWrench: no stage of follow, ardusub"):
            jax.eval_shape(step, scene.fleet, scene.worlds, state, told["wrench"])
