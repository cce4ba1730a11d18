"""Trees as planes, by emitted C, against the layouts themselves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.lanes.planes import PlaneLayout
from angler_mjx.sim.engines.cuda.launch import LaunchShape
from angler_mjx.sim.engines.cuda.packing import MAX_PLANES, pack_trees

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
