"""Trees to planes and back, by emitted C, against the layouts themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.lanes.planes import PlaneLayout
from angler_mjx.sim.engines.cuda.engine import CudaEngine
from angler_mjx.sim.engines.cuda.launch import LaunchShape
from angler_mjx.sim.engines.cuda.packing import MAX_PLANES, pack_trees, unpack_trees
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
def test_kernels_lay_out_as_the_layouts_do():
    given = trees()
    layouts = [PlaneLayout.of(tree, 2) for tree in given]
    expected = pack_trees(None, layouts, given, jnp.float32)

    @jax.jit
    def there_and_back(given):
        shape = LaunchShape(block=4)
        flats = pack_trees(shape, layouts, given, jnp.float32)
        return flats, unpack_trees(shape, layouts, flats, (WORLDS, ROWS))

    flats, back = there_and_back(given)
    for ours, theirs in zip(flats, expected, strict=True):
        np.testing.assert_array_equal(ours, theirs)
    assert len(set(np.asarray(flats[0]).tolist())) == WORLDS * ROWS * 12
    for ours, theirs in zip(jax.tree.leaves(back), jax.tree.leaves(given), strict=True):
        assert ours.dtype == theirs.dtype
        np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize("tail", [(MAX_PLANES + 1,), (0,)])
def test_tables_and_empty_leaves_are_left_to_xla(tail):
    tree = {"table": jnp.ones((WORLDS, ROWS, *tail)), "number": jnp.ones((WORLDS, ROWS))}
    layout = PlaneLayout.of(tree, 2)
    shape = LaunchShape(block=4)  # a kernel would need a GPU here
    (flat,) = pack_trees(shape, [layout], [tree], jnp.float32)
    (back,) = unpack_trees(shape, [layout], [flat], (WORLDS, ROWS))
    assert back["table"].shape == (WORLDS, ROWS, *tail)


@pytest.mark.usefixtures("compiled_sources")
@pytest.mark.parametrize("block", [4, 5])
def test_ended_worlds_begin_anew(scenes, block):
    """By kernels, and by XLA where blocks do not divide the worlds."""
    scene = scenes[0](WORLDS)
    begun = jax.device_get(FusedEngine().reset(scene.spec, scene.fleet, scene.worlds))
    random = np.random.default_rng(5)

    def change(leaf):
        return jnp.asarray(random.integers(0, 90, leaf.shape).astype(leaf.dtype))

    now, initial = jax.tree.map(change, begun), jax.tree.map(change, begun)
    ended = jnp.asarray([True, False, False, True, False, False, True, False])
    rows = jnp.asarray(random.integers(0, WORLDS, WORLDS), jnp.int32)
    after = jax.jit(CudaEngine(block=block).replace_worlds)(now, ended, initial, rows)
    for ours, old, new in zip(*map(jax.tree.leaves, (after, now, initial)), strict=True):
        assert ours.dtype == old.dtype
        for world in range(WORLDS):
            expected = new[rows[world]] if ended[world] else old[world]
            np.testing.assert_array_equal(ours[world], expected)
