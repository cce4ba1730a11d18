"""Trees as planes, by emitted C, against the layouts themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.lanes.planes import PlaneLayout
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.cuda.launch import LaunchShape
from angler_mjx.sim.engines.cuda.packing import MAX_PLANES, pack_trees
from angler_mjx.sim.engines.lanes.engine import FusedEngine

WORLDS, ROWS = 8, 3


def trees():
    """Trees with leaves of all types and ranks of a state."""
    random = np.random.default_rng(3)
    lead = (WORLDS, ROWS)
    return [
        {
            "p": jnp.asarray(random.normal(size=(*lead, 3)), jnp.float32),
            "block": jnp.asarray(random.normal(size=(*lead, 2, 4)), jnp.float32),
            "number": jnp.asarray(random.normal(size=lead), jnp.float32),
        },
        {
            "outcome": jnp.asarray(random.integers(-1, 5, lead), jnp.int32),
            "passed": jnp.asarray(random.random(lead) < 0.5),
        },
    ]


@pytest.mark.usefixtures("compiled_sources")
def test_a_kernel_lays_out_as_the_layouts_do():
    given = trees()
    layouts = [PlaneLayout.of(tree, 2) for tree in given]
    expected = pack_trees(None, layouts, given, jnp.float32)

    @jax.jit
    def pack(given):
        return pack_trees(LaunchShape(block=4), layouts, given, jnp.float32)

    flats = pack(given)
    for ours, theirs in zip(flats, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert len(set(np.asarray(flats[0]).tolist())) == WORLDS * ROWS * 12
    for layout, flat, tree in zip(layouts, flats, given, strict=True):
        back = layout.unpack(flat, (WORLDS, ROWS))
        jax.tree.map(np.testing.assert_array_equal, back, tree)


@pytest.mark.parametrize("tail", [(MAX_PLANES + 1,), (0,)])
def test_tables_and_empty_leaves_are_left_to_xla(tail):
    tree = {"table": jnp.ones((WORLDS, ROWS, *tail)), "number": jnp.ones((WORLDS, ROWS))}
    layout = PlaneLayout.of(tree, 2)
    shape = LaunchShape(block=4)  # a kernel would need a GPU here
    (flat,) = pack_trees(shape, [layout], [tree], jnp.float32)
    assert flat.size == layout.size


@pytest.fixture
def random_states(scenes):
    """Two states of eight worlds, of random numbers."""
    scene = scenes[0](WORLDS)
    begun = jax.device_get(FusedEngine().reset(scene.spec, scene.fleet, scene.worlds))
    random = np.random.default_rng(5)

    def change(leaf):
        return jnp.asarray(random.integers(0, 90, leaf.shape).astype(leaf.dtype))

    return jax.tree.map(change, begun), jax.tree.map(change, begun)


ENGINES = [CudaEngine(block=4), CudaEngine(block=5), FusedEngine()]


@pytest.mark.usefixtures("compiled_sources")
@pytest.mark.parametrize("engine", ENGINES, ids=["blocks of 4", "of 5", "lanes"])
def test_states_are_kept_selected_and_replaced(random_states, engine):
    now, initial = random_states
    ended = jnp.asarray([True, False, False, True, False, False, True, False])
    rows = jnp.asarray([3, 1, 7, 7, 0, 2, 5, 4], jnp.int32)

    @jax.jit
    def change(now, initial):
        packed, others = engine.pack_state(now), engine.pack_state(initial)
        selected = engine.select_states(others, rows[:3])
        replaced = engine.replace_states(packed, ended, others, rows)
        energy = engine.replace_energy(packed, now.tally.energy_j + 100.0)
        return [engine.unpack_state(x) for x in (packed, selected, replaced, energy)]

    packed, selected, replaced, energy = change(now, initial)
    jax.tree.map(np.testing.assert_array_equal, packed, now)
    jax.tree.map(
        lambda ours, theirs: np.testing.assert_array_equal(ours, theirs[rows[:3]]),
        selected,
        initial,
    )
    for ours, old, new in zip(*map(jax.tree.leaves, (replaced, now, initial)), strict=True):
        assert ours.dtype == old.dtype
        for world in range(WORLDS):
            np.testing.assert_array_equal(
                ours[world], new[rows[world]] if ended[world] else old[world]
            )
    np.testing.assert_array_equal(energy.tally.energy_j, now.tally.energy_j + 100.0)
    assert energy.tally.path_length_m.tolist() == now.tally.path_length_m.tolist()


@pytest.mark.usefixtures("compiled_sources")
def test_steps_between_packed_states_are_control_steps(scenes):
    """Of five worlds of a bank of three, in blocks of two, with one command."""
    build, members, obstacles = scenes
    scene = build(3, members=members("bluerov2"), config=obstacles["all"])
    rows = jnp.asarray([2, 0, 1, 2, 0], jnp.int32)
    engine = CudaEngine(block=2)
    begun = FusedEngine().reset(scene.spec, scene.fleet, scene.worlds)
    constants = engine.pack_constants(scene.fleet, scene.worlds)
    inputs = scene.spec, scene.fleet, scene.worlds

    @jax.jit
    def advance(begun):
        packed = engine.select_states(engine.pack_state(begun), rows)
        for steps in (1, 2):
            packed = engine.advance(*inputs, packed, None, rows, constants, steps)
        return engine.unpack_state(packed)

    @jax.jit
    def step(begun):
        state = jax.tree.map(lambda leaf: leaf[rows], begun)
        for steps in (1, 2):
            state = engine.control_step(
                *inputs, state, None, rows=rows, constants=constants, steps=steps
            )[0]
        return state

    ours, theirs = advance(begun), step(begun)
    jax.tree.map(np.testing.assert_array_equal, ours, theirs)
    assert ours.step.tolist() == [3] * 5
    assert float(jnp.abs(ours.vehicles.nu).max()) > 0


@pytest.mark.usefixtures("compiled_sources")
@pytest.mark.parametrize(
    ("engine", "other"), [(FusedEngine(), CudaEngine(block=4)), (CudaEngine(), FusedEngine())]
)
def test_a_state_of_another_engine_is_refused(random_states, engine, other):
    alien = jax.eval_shape(other.pack_state, random_states[0])
    with pytest.raises(TypeError, match="is no"):
        engine.unpack_state(alien)
