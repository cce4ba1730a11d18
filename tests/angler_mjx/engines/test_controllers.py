"""Every stack that has a name, in closed loop in the simulator, on both engines, in float64.

And what else can drive the controllers: all kinds of commands, on lanes and in kernels.
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import lanes
from angler_mjx.control import stack, stages
from angler_mjx.control.commands import BodyTwist, BodyWrench, PoseTarget, ThrusterPwm
from angler_mjx.control.joint_trajectory import from_path
from angler_mjx.control.laws.targets import as_tracking
from angler_mjx.engines.lanes.engine import FusedEngine, OfGroup
from angler_mjx.engines.lanes.layout import (
    moving_of,
    scene_of,
    spread_out,
    to_arrays,
    to_lanes,
)
from angler_mjx.engines.triton.engine import TritonEngine
from angler_mjx.errors import ConfigError
from angler_mjx.sim import robot, step
from angler_mjx.sim.state import Outcome
from angler_mjx.world import currents

from ..compiling import quickly

WORLDS, PARITY, LONGEST = 3, 40, 900
"""Worlds; control steps in which engines are compared, 2 s; and in which robots must arrive, 45 s.
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
    yaw = scene.worlds.environment.start_yaw_rad

    def start(spec):
        begin = jax.vmap(jax.vmap(partial(robot.begin, spec)))
        return replace(first, carry=begin(first.vehicles, yaw))

    return start


def spec_of(scene, names, gains=None):
    made, numbers = stages.build(names, gains or {})
    return replace(scene.spec, stages=made, gains=numbers)


def on_lanes(spec, kinds, worlds, state):
    """Memory and signals of the controllers, as the fused engine has them decide."""
    scene, moving = scene_of(kinds, worlds), moving_of(kinds, state)
    (given,), (robots,) = scene.groups, moving.groups
    t = time_of(spec, state)
    here = OfGroup(spec=spec, scene=scene, t=t, shape=scene.shape, given=given)
    done = step.decide(here, {"known": robots.vehicle, "memory": robots.memory})
    like = robots.vehicle.p[0]
    given_back = (done.slots()["memory"], done.record()["pwm_us"])
    return to_arrays(jax.tree.map(lambda leaf: spread_out(leaf, like), given_back), 2)


def mapped(spec, kinds, worlds, state):
    """The same as the mjx engine has them decide."""

    def one(world, vehicles, carry):
        flow = jax.vmap(currents.velocity, (None, 0, None))(
            world.environment.current, vehicles.p, time_of(spec, state)
        )
        decided = jax.vmap(partial(robot.decide, spec))(
            world.control, carry, vehicles, world.path, flow
        )
        return decided[0], decided[2].pwm_us

    return jax.vmap(one)(worlds, state.vehicles, state.carry)


def time_of(spec, state):
    return state.step[0].astype(state.vehicles.p.dtype) * spec.control_dt_s


@pytest.fixture(scope="module")
def flown(scene, at_rest, engines_by_name):
    """A function (controller, engine, steps) -> states after each step of `PARITY`, and the end.

    Controllers are compiled apart from their engine, which takes their signals and is compiled
    once; how the two are put together is compared for one of them below.
    """
    deciding = {"fused": on_lanes, "mjx": mapped}
    stepping = {
        name: quickly(partial(engine.control_step, scene.spec))
        for name, engine in engines_by_name.items()
    }

    @cache
    def fly(name, engine, steps):
        with jax.enable_x64(True):
            spec = spec_of(scene, stages.CONTROLLERS[name])
            decide = quickly(partial(deciding[engine], spec))
            state, seen = at_rest(spec), []
            signals = stack.Memory(stages=(), realised=None)
            for i in range(steps):
                carry, pwm = decide(scene.fleet, scene.worlds, state)
                alone = replace(state, carry=signals)
                after, _ = stepping[engine](
                    scene.fleet, scene.worlds, alone, ThrusterPwm(pwm_us=pwm)
                )
                state = replace(after, carry=carry)
                if i < PARITY:
                    seen.append((state, pwm))
                elif i % 20 == 0 and np.all(np.asarray(state.tally.outcome) != Outcome.RUNNING):
                    break
            return seen, state

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


DAILY = ("cascade", "tracking", "ardusub")
"""Flown in every run of the tests: a controller of each kind of stage."""


def controllers(by):
    """All, but those of a day alone by night; ``by`` proves the others in small."""
    return [
        name if name in DAILY else pytest.param(name, marks=pytest.mark.nightly(by=by))
        for name in stages.CONTROLLERS
    ]


@pytest.mark.parametrize("name", controllers(by="control/laws/test_lanes.py"))
def test_both_engines_fly_it_alike(name, flown):
    ours, _ = flown(name, "fused", LONGEST)
    theirs, _ = flown(name, "mjx", PARITY)
    # As for the cascade: float64 leaves rounding no room; found is 1e-12.
    assert_close(ours[-1], theirs[-1], 1e-9)
    assert_close(ours[10], theirs[10], 1e-9)
    assert np.abs(np.asarray(ours[-1][0].vehicles.nu[..., :3])).max() > 0.1


@pytest.mark.parametrize("name", stages.CONTROLLERS)
def test_a_segment_of_it_can_be_put_together(name, scene, at_rest, engines_by_name):
    """Traced, not computed: every leaf of the memory comes out as it went in."""
    spec = spec_of(scene, stages.CONTROLLERS[name])
    with jax.enable_x64(True):
        state = at_rest(spec)
        run = partial(engines_by_name["fused"].segment, spec, n_sample=1, steps_per_sample=2)
        after, sample = jax.eval_shape(run, scene.fleet, scene.worlds, state)
    assert jax.tree.structure(after) == jax.tree.structure(state)
    for x, y in zip(jax.tree.leaves(after), jax.tree.leaves(state), strict=True):
        assert (x.shape, x.dtype) == (y.shape, y.dtype)
    assert sample.target_m.shape == (WORLDS, 1, 1, 3)


@pytest.mark.parametrize("name", controllers(by="control/laws/test_closed_loops.py"))
def test_it_brings_robots_to_their_goals(name, flown):
    _, end = flown(name, "fused", LONGEST)
    assert np.all(np.asarray(end.tally.outcome) == Outcome.REACHED), np.asarray(end.tally.outcome)
    assert np.asarray(end.tally.path_length_m).min() > 3.0


def commands(scene, state):
    """One of each kind for every robot."""
    environment = scene.worlds.environment
    shape = environment.start_yaw_rad.shape
    random = np.random.default_rng(3)

    def some(*tail):
        return jnp.asarray(random.normal(size=(*shape, *tail)))

    pose = PoseTarget(
        position_m=state.vehicles.p + some(3), velocity_mps=0.1 * some(3), yaw_rad=some()
    )
    return {
        "path": scene.worlds.path,
        "joints": jax.vmap(jax.vmap(from_path))(scene.worlds.path, environment.start_yaw_rad),
        "pose": pose,
        "tracking": jax.vmap(jax.vmap(as_tracking))(pose),
        "twist": BodyTwist(nu=0.3 * some(6)),
        "wrench": BodyWrench(tau=20.0 * some(6)),
        "signals": ThrusterPwm(pwm_us=1500 + 100 * some(8)),
    }


KINDS = ["path", "joints", "pose", "tracking", "twist", "wrench", "signals"]


@pytest.mark.parametrize("kind", KINDS)
def test_lanes_take_every_kind_of_command(kind, scene, at_rest):
    """What the fused engine does with a command is what the mjx engine does with it."""
    with jax.enable_x64(True):
        state = at_rest(scene.spec)
        command = commands(scene, state)[kind]
        params = scene.worlds.control
        decide = partial(robot.decide, scene.spec, flow=None)
        expected = quickly(jax.vmap(jax.vmap(decide)))(params, state.carry, state.vehicles, command)
        given = scene_of(scene.fleet, scene.worlds).groups[0].params
        moving = to_lanes((state.carry, state.vehicles, command), 2)
        found = to_arrays(lanes.apply(decide, given, *moving), 2)
        for x, y in zip(jax.tree.leaves(found), jax.tree.leaves(expected), strict=True):
            # The same numbers in another order of adding; signals are of 1500 us.
            np.testing.assert_allclose(np.broadcast_to(x, y.shape), y, rtol=1e-12, atol=1e-9)


def test_a_command_drives_whole_segments_alike(scene, at_rest, engines_by_name):
    """A JointTrajectory under a law that wants the current and the wrench that was realised."""
    spec = spec_of(scene, stages.CONTROLLERS["tracking"], {"reference": {"lag_slow_m": 0.2}})
    ends = []
    with jax.enable_x64(True):
        state = at_rest(spec)
        command = commands(scene, state)["joints"]
        for engine in engines_by_name.values():
            run = partial(engine.segment, spec, n_sample=3, steps_per_sample=5)
            compiled = quickly(lambda f, w, s, c, run=run: run(f, w, s, command=c))
            ends.append(compiled(scene.fleet, scene.worlds, state, command))
    assert_close(ends[1], ends[0], 1e-9)
    after, sample = ends[0]
    assert sample.target_m.shape == (WORLDS, 3, 1, 3)
    assert np.abs(after.carry.realised.tau).max() > 1.0
    # Followed, not the path: a line from way-point to way-point is the same, but not the heading.
    assert np.all(np.asarray(after.carry.stages[0].clock_s) > 0.5)


# The cascade's are lowered elsewhere; the others have no operation that these have not.
@pytest.mark.parametrize("name", ["los", "tracking", "ismc", "aitsm", "ardusub"])
@pytest.mark.usefixtures("as_if_on_an_h200")
def test_kernels_of_every_controller_lower_for_cuda(name, scene, at_rest):
    spec, engine = spec_of(scene, stages.CONTROLLERS[name]), TritonEngine()
    with jax.enable_x64(True):
        state = at_rest(spec)
        # The command that reads most from memory: tables of numbers and of whole numbers.
        told = commands(scene, state)["path" if name == "los" else "joints"]
        given = scene.fleet, scene.worlds, state, told
        single = jax.tree.map(
            lambda x: x.astype(jnp.float32) if jnp.issubdtype(x.dtype, jnp.floating) else x, given
        )
    traced = jax.jit(partial(engine.control_step, spec)).trace(*single)
    text = traced.lower(lowering_platforms=("cuda",)).as_text()
    assert text.count("__gpu$xla.gpu.triton") == 3


def test_a_command_that_the_controllers_do_not_take_is_refused(scene, at_rest):
    spec = spec_of(scene, stages.CONTROLLERS["ardusub"])
    with jax.enable_x64(True):
        state = at_rest(spec)
        told = commands(scene, state)["wrench"]
        step = partial(FusedEngine().control_step, spec)
        with pytest.raises(ConfigError, match="BodyWrench: no stage of follow, ardusub"):
            jax.eval_shape(step, scene.fleet, scene.worlds, state, told)
