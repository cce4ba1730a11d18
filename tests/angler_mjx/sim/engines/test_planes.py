"""Trees of arrays in one flat array: what is packed is what is read, written and unpacked."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import lanes
from angler_kernels.lanes.planes import TABLE_MIN_ROWS, PlaneLayout, is_table

W, R = 5, 3


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Body:
    matrix: jax.Array
    flag: jax.Array
    number: jax.Array
    long: jax.Array


def body(lead):
    rng = np.random.default_rng(0)
    return Body(
        matrix=jnp.asarray(rng.normal(size=(*lead, 2, 3)), jnp.float32),
        flag=jnp.asarray(rng.random(lead) < 0.5),
        number=jnp.asarray(rng.integers(-9, 9, (*lead, 2)), jnp.int32),
        long=jnp.asarray(rng.normal(size=(*lead, TABLE_MIN_ROWS + 1, 2)), jnp.float32),
    )


def assert_equal(one, other):
    for x, y in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
        assert x.dtype == y.dtype
        np.testing.assert_array_equal(x, y)


@pytest.mark.parametrize("lead", [(W,), (W, R)])
def test_unpacks_what_was_packed(lead):
    tree = body(lead)
    layout = PlaneLayout.of(tree, len(lead))
    flat = layout.pack(tree, jnp.float32)
    assert flat.shape == (layout.planes * layout.lanes,)
    assert layout.planes == 6 + 1 + 2 + 2 * (TABLE_MIN_ROWS + 1)
    assert_equal(layout.unpack(flat, lead), tree)


def test_unpacks_a_series():
    trees = [
        jax.tree.map(lambda x, k=k: x if x.dtype == bool else x + k, body((W, R))) for k in range(4)
    ]
    layout = PlaneLayout.of(trees[0], 2)
    flat = jnp.stack([layout.pack(tree, jnp.float32) for tree in trees])
    back = layout.unpack(flat, (W, R))
    for k, tree in enumerate(trees):
        assert_equal(jax.tree.map(lambda x, k=k: x[:, k], back), tree)


def test_reads_and_writes_lanes():
    """Lane r W + w is robot r of world w; long arrays are tables, read by the entry."""
    tree = body((W, R))
    layout = PlaneLayout.of(tree, 2)
    flat = layout.pack(tree, jnp.float32)
    row, worlds = 2, jnp.array([4, 0, 3])
    got = layout.read_lanes(lambda place: flat[place], row * W + worlds)
    assert is_table((TABLE_MIN_ROWS + 1, 2))
    assert not is_table((TABLE_MIN_ROWS, 2))
    assert isinstance(got.long, lanes.LookupTable)
    wanted = jax.tree.map(lambda x: x[worlds, row], tree)
    for name in ("matrix", "flag", "number"):
        x, y = lanes.join(getattr(got, name)), getattr(wanted, name)
        assert x.dtype == y.dtype
        np.testing.assert_array_equal(x, y)
    np.testing.assert_array_equal(got.long.take([7, 1]), wanted.long[:, 7, 1])
    places = jnp.array([0, 1, TABLE_MIN_ROWS])
    np.testing.assert_array_equal(got.long.take([places, 0]), wanted.long[np.arange(3), places, 0])


def test_writes_lanes_and_nothing_else():
    tree = body((W, R))
    tree = {"matrix": tree.matrix, "flag": tree.flag, "number": tree.number}
    layout = PlaneLayout.of(tree, 2)
    row, worlds = 1, np.array([4, 0, 3])
    chosen = jax.tree.map(lambda x: x[worlds, row], tree)
    target = np.full(layout.planes * layout.lanes, np.nan)

    def store(place, value):
        target[place] = value

    layout.write_lanes(store, row * W + worlds, lanes.split(chosen))
    written = ~np.isnan(target).reshape(layout.planes, R, W)
    assert written[:, row, worlds].all()
    assert written.sum() == layout.planes * len(worlds)
    back = layout.unpack(jnp.asarray(np.nan_to_num(target)), (W, R))
    assert_equal(jax.tree.map(lambda x: x[worlds, row], back), chosen)
