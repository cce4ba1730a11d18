"""Plans of either type and of many points: both engines fly them alike, padding changes no byte.

In float64, as `test_controllers`; whole flights of other worlds are compared in `test_fused`.
"""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.robot.control import stages
from angler_mjx.robot.control.commands.joint_trajectory import CUBIC, from_path
from angler_mjx.robot.control.plans import check_plan
from angler_mjx.sim import fleet, step
from angler_mjx.sim.engines.cuda.kernels import Kernels
from angler_mjx.sim.engines.cuda.launch import LaunchShape
from angler_mjx.sim.engines.cuda.packed_state import PackedState
from angler_mjx.sim.engines.cuda.segment import Segment
from angler_mjx.sim.engines.cuda.tile import Tile
from angler_mjx.sim.engines.lanes.engine import SceneBatch
from angler_mjx.sim.engines.lanes.layout import (
    broadcast_lanes,
    lane_state_of,
    scene_of,
    to_arrays,
    to_lanes,
)
from angler_mjx.sim.engines.mjx import SingleWorld
from angler_mjx.sim.step import DECIDE

from ...compiling import quickly

WORLDS, MANY = 3, 1024


@pytest.fixture(scope="module")
def scene(scenes):
    """Heavies of all parameter sets; nothing to hit."""
    build, members, obstacles = scenes
    with jax.enable_x64(True):
        return build(WORLDS, members=members("bluerov2_heavy"), config=obstacles["none"])


@pytest.fixture(scope="module")
def begun(scene, begun):
    """Somewhere along the plans: each robot at a time of its own, near where it should be."""
    state = begun(scene, "fused")
    first, *rest = state.carry.stages
    path = scene.worlds.path
    clock = np.linspace(0.2, 0.9, WORLDS)[:, None] * np.asarray(path.time_s)[..., -1]
    place = chords(path, clock) + 0.1
    carry = replace(state.carry, stages=(replace(first, clock_s=clock), *rest))
    return replace(state, carry=carry, vehicles=replace(state.vehicles, p=place))


def chords(path, clock):
    """Places [W, 1, 3] on straight lines between the way-points of one robot of each world."""
    return np.array(
        [
            [[np.interp(t[0], time[0], axis) for axis in point[0].T]]
            for t, time, point in zip(clock, path.time_s, path.position_m, strict=True)
        ]
    )


@pytest.fixture(scope="module")
def plans(scene):
    """By type: as it is planned, and padded to many points."""
    path, yaw = scene.worlds.path, scene.worlds.environment.start_yaw_rad
    with jax.enable_x64(True):
        lines = quickly(jax.vmap(jax.vmap(from_path)))(path, yaw)
    # Bent between its points: cubics with velocities that the lines do not have.
    random = np.random.default_rng(1)
    bent = replace(
        jax.device_get(lines),
        velocity=0.2 * random.normal(size=lines.velocity.shape),
        degree=np.full(lines.degree.shape, CUBIC, np.int32),
    )
    few = {"way-points": jax.device_get(path), "joints": bent}
    return few, {name: padded(plan) for name, plan in few.items()}


def padded(plan):
    def edge(leaf):
        return np.pad(
            leaf,
            [(0, 0)] * 2 + [(0, MANY - leaf.shape[2])] + [(0, 0)] * (leaf.ndim - 3),
            mode="edge",
        )

    names = ("time_s", "position_m", "position", "velocity", "acceleration", "degree")
    return replace(plan, **{n: edge(getattr(plan, n)) for n in names if hasattr(plan, n)})


def on_lanes(spec, kinds, worlds, state):
    """Memory, signals and aim of the controllers, as the fused engine has them decide."""
    scene, moving = scene_of(kinds, worlds), lane_state_of(kinds, state)
    (given,), (robots,) = scene.groups, moving.groups
    batch = SceneBatch(spec=spec, scene=scene, t=jnp.zeros(()), shape=scene.shape)
    done = step.decide_commands(
        batch,
        step.DecideInput(
            estimate=robots.vehicle,
            memory=robots.memory,
            flow=step.select_flow(batch, lambda: batch.current, robots.vehicle),
            params=given.params,
            command=check_plan(spec.stages, given.path),
        ),
    )
    like = robots.vehicle.p[0]
    back = (done.output().memory, done.record())
    return to_arrays(jax.tree.map(lambda leaf: broadcast_lanes(leaf, like), back), 2)


def mapped(spec, kinds, worlds, state):
    """The same as the mjx engine has them decide."""

    def one(world, vehicles, carry):
        batch = SingleWorld(spec=spec, world=world, t=jnp.zeros(()))
        current = world.environment.current
        done = step.decide_commands(
            batch,
            step.DecideInput(
                estimate=vehicles,
                memory=carry,
                flow=step.select_flow(batch, lambda: current, vehicles),
                params=world.control,
                command=check_plan(spec.stages, world.path),
            ),
        )
        return done.output().memory, done.record()

    return jax.vmap(one)(fleet.add_parameters(kinds, worlds), state.vehicles, state.carry)


@pytest.fixture(scope="module")
def decided(scene, begun, plans):
    """A function (engine, type, many) -> what the controllers decide; kept."""
    engines = {"fused": on_lanes, "mjx": mapped}

    @cache
    def decide(engine, name, many):
        with jax.enable_x64(True):
            worlds = replace(scene.worlds, path=plans[many][name])
            one = quickly(partial(engines[engine], scene.spec))
            return jax.device_get(one(scene.fleet, worlds, begun))

    return decide


LINES = pytest.param(
    "way-points", marks=pytest.mark.nightly(by="joints; control/test_trajectory.py for their lines")
)


@pytest.mark.parametrize("name", [LINES, "joints"])
def test_both_engines_decide_alike_along_plans_of_many_points(name, decided, begun):
    memory, seen = decided("fused", name, True)
    for (path, x), y in zip(
        jax.tree_util.tree_leaves_with_path((memory, seen)),
        jax.tree.leaves(decided("mjx", name, True)),
        strict=True,
    ):
        # float64 leaves rounding no room, of signals of 1500 us.
        np.testing.assert_allclose(
            np.broadcast_to(x, y.shape),
            y,
            rtol=1e-12,
            atol=1e-9,
            err_msg=jax.tree_util.keystr(path),
        )
    assert np.abs(seen["target_m"] - begun.vehicles.p).max() > 0.05
    assert np.ptp(seen["pwm_us"]) > 10.0


@pytest.mark.parametrize("engine", ["fused", "mjx"])
@pytest.mark.parametrize("name", [LINES, "joints"])
def test_padding_changes_no_byte(name, engine, decided):
    for x, y in zip(
        jax.tree.leaves(decided(engine, name, False)),
        jax.tree.leaves(decided(engine, name, True)),
        strict=True,
    ):
        np.testing.assert_array_equal(x, y)


def test_what_is_bent_is_flown_bent(decided, begun, scene):
    """The cubics lead elsewhere than their chords."""
    aim = decided("fused", "joints", True)[1]["target_m"]
    clock = np.asarray(begun.carry.stages[0].clock_s)
    assert np.linalg.norm(aim - chords(scene.worlds.path, clock), axis=-1).max() > 0.05


@pytest.mark.usefixtures("as_if_on_an_h200")
def test_the_kernel_reads_joints_of_many_points(scene, begun, plans):
    given = replace(scene.worlds, path=plans[True]["joints"]), begun, scene.fleet
    worlds, state, kinds = jax.tree.map(single, given)

    def decide(worlds, state):
        part = Segment(Tile(kinds, worlds), PackedState.of(state, 1, None), 1, 1, None, None)
        kernels = Kernels(LaunchShape(block=1), scene.spec, part)
        begin = np.zeros(1, np.int32)
        return kernels.run_phase(DECIDE, part.tile.groups[0], begin, begin, part.start)

    traced = jax.jit(decide).trace(worlds, state)
    text = traced.lower(lowering_platforms=("cuda",)).as_text()
    assert text.count("__gpu$xla.gpu.ptx") == 1


def single(x):
    return np.asarray(x, np.float32) if jnp.issubdtype(x.dtype, jnp.floating) else x


@pytest.mark.parametrize(
    "engine", ["fused", pytest.param("mjx", marks=pytest.mark.nightly(by="fused"))]
)
def test_plans_that_the_controllers_do_not_take_are_refused(engine, scene, plans, engines_by_name):
    made, numbers = stages.build_stack(stages.CONTROLLERS["los"], {})
    spec = replace(scene.spec, stages=made, gains=numbers)
    with jax.enable_x64(True):
        worlds = replace(scene.worlds, path=plans[False]["joints"])
        one = engines_by_name[engine]
        state = jax.eval_shape(partial(one.reset, spec), scene.fleet, worlds)
        said = "World.path is a JointTrajectory: controller 'los' takes Trajectory"
        with pytest.raises(ConfigError, match=said):
            jax.eval_shape(
                partial(one.segment, spec, n_sample=1, steps_per_sample=1),
                scene.fleet,
                worlds,
                state,
            )


def test_more_numbers_than_can_be_counted_are_refused():
    shape = jax.ShapeDtypeStruct((2**19, 1, 4096), jnp.float32)
    with pytest.raises(RunError, match="use a tile 2 times smaller"):
        jax.eval_shape(lambda leaf: lowest(to_lanes(leaf, 2)), shape)


def lowest(table):
    return table[0]
