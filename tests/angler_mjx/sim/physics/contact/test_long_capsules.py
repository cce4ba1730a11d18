"""Pipes longer than a cell of rock: on two columns, on one, along many, and past each other."""

from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.sim.physics.contact import candidates, mjx_contact
from angler_mjx.sim.physics.contact.candidates import Rock
from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE
from angler_mjx.world.rock.grid import Grid

from ....compiling import thoroughly
from .loose_bodies import DT, FRICTION, NO_HULLS, describe, lay_out, push

CELL, TOP = 1.5, 3.0
"""m: edge of a cell, and height of the columns' tops."""
LENGTH, G, DRAG = 3.0, 1.0, 0.8
"""m; m/s2 of the net weight in water; 1/s of its resistance."""
MASS = 20.0
ALONG = np.array([1.0, 1.0, 0.0]) / np.sqrt(2.0)
"""Axis of a pipe across corners of cells."""
ACROSS = np.array([1.0, -1.0, 0.0]) / np.sqrt(2.0)
DIAGONAL = CELL * np.sqrt(2.0)
DIVIDED = 2
"""Pieces of a pipe of 3 m among cells of 1.5 m."""


@dataclass(frozen=True)
class Sunk:
    """Records [time, ...] of bodies that sank."""

    p: np.ndarray
    axis: np.ndarray
    """[time, n, 3] third axes, in W."""
    force_n: np.ndarray
    """[time, k] normal forces."""
    position: np.ndarray
    """[time, k, 3] of the points of contact."""
    second: np.ndarray
    """[time, k] shapes."""


def columns(*cells):
    """Return a grid of 12 x 12 columns, of which ``cells`` stand."""
    occupied = np.zeros((12, 12, 2), bool)
    for i, j in cells:
        occupied[i, j] = True
    return Grid(occupied=occupied, origin_m=np.zeros(3), cell_m=np.asarray(CELL))


def turned_to(axis):
    """Return the attitude that turns z to a horizontal axis."""
    turn = np.cross([0.0, 0.0, 1.0], axis) * np.sin(np.pi / 4.0)
    return np.array([np.cos(np.pi / 4.0), *turn])


def sinking(layout, bodies, grid, seconds, every=10):
    """Return a function of positions [n, 3] and attitudes [n, 4] that gives what `Sunk` records."""

    def sink(p, q):
        rock = Rock.of(jax.tree.map(jnp.asarray, grid))
        ground = rock, jnp.asarray(-50.0, p.dtype)
        down = jnp.array([0.0, 0.0, -G], p.dtype)

        def step(_, now):
            p, q, v, _ = now
            return push(layout, bodies, down - DRAG * v[:, :3], ground, (p, q, v))

        def record(now, _):
            later = jax.lax.fori_loop(0, every, step, now)
            p, q, _, forces = later
            w, x, y, z = q.T
            axis = jnp.stack(
                [2.0 * (x * z + w * y), 2.0 * (y * z - w * x), 1.0 - 2.0 * (x * x + y * y)], axis=1
            )
            touches = forces.touches
            return later, (p, axis, forces.normal_force_n, touches.position, touches.second)

        v = jnp.zeros((p.shape[0], 6), p.dtype)
        start = push(layout, bodies, down, ground, (p, q, v))
        return jax.lax.scan(record, start, None, length=round(seconds / DT / every))[1]

    return sink


def pipes(n, radius, length):
    """Return n pipes of uniform mass along their length."""
    spin = MASS * (length**2 / 12.0 + radius**2 / 4.0)
    size = [[radius, 0.5 * length, 0.0]] * n
    return describe([CAPSULE] * n, size, [MASS] * n, [spin] * n)


def sink_one(grid, radius, centers, axis, seconds=8.0, wide=False, pieces=DIVIDED):
    """Sink pipes, each in its world [w, ...]; see `Sunk`."""
    with jax.enable_x64(wide):
        dtype = float if wide else np.float32
        bodies = jax.tree.map(
            lambda leaf: leaf.astype(dtype) if leaf.dtype == float else leaf,
            pipes(1, radius, LENGTH),
        )
        layout = lay_out(1, boxes=False, axis_pieces=(pieces,))
        grid = Grid(
            occupied=grid.occupied,
            origin_m=grid.origin_m.astype(dtype),
            cell_m=grid.cell_m.astype(dtype),
        )
        sink = thoroughly(jax.vmap(sinking(layout, bodies, grid, seconds), (0, None)))
        p = np.asarray(centers, dtype)[:, None]
        return Sunk(*jax.device_get(sink(p, turned_to(axis)[None].astype(dtype))))


def least_gap(sunk, radius, grid):
    """Return the least gap [w], m, of pipes to columns over time, from dense points of axes."""
    s = np.linspace(-0.5 * LENGTH, 0.5 * LENGTH, 1201)[:, None]
    points = sunk.p[:, :, 0, None, :] + s * sunk.axis[:, :, 0, None, :]
    gap = np.full(points.shape[0], np.inf)
    for i, j in np.argwhere(grid.occupied.any(axis=2)):
        low = np.array([i * CELL, j * CELL, 0.0])
        high = np.array([(i + 1) * CELL, (j + 1) * CELL, TOP])
        inside = np.maximum(np.maximum(low - points, points - high), 0.0)
        distance = np.linalg.norm(inside, axis=-1) - radius
        depth = np.minimum(points - low, high - points).min(axis=-1)  # where the axis is in rock
        distance = np.where(depth > 0.0, -radius - depth, distance)
        gap = np.minimum(gap, distance.min(axis=(1, 2)))
    return gap


def corner(i, j, cut):
    """Return the middle of the line along `ALONG` that cuts ``cut`` off a corner of a column."""
    return np.array([(i + 1) * CELL, j * CELL, TOP]) - cut * ACROSS


def test_a_pipe_across_two_columns_rests_by_the_rule_of_the_lever():
    cut, radius = 0.02, 0.1
    grid = columns((4, 4), (5, 5))
    behind = np.array([0.7, 0.9, 1.05, 1.25, 1.4])  # of its middle, the first column is
    centers = corner(4, 4, cut) + behind[:, None] * ALONG + [0.0, 0.0, radius + 0.1]
    sunk = sink_one(grid, radius, centers, ALONG, wide=True)
    weight = MASS * G
    last = slice(-20, None)
    force = sunk.force_n[:, last]
    s = (sunk.position[:, last] - sunk.p[:, last]) @ ALONG
    first = np.sum(force * (s < 0.0), axis=2)
    second = np.sum(force * (s > 0.0), axis=2)
    np.testing.assert_allclose(first + second, weight, rtol=1e-3)
    ahead = DIAGONAL - behind
    lever = ahead / DIAGONAL
    np.testing.assert_allclose(first, weight * lever[:, None] * np.ones(20), atol=weight * cut)
    level = np.abs(sunk.axis[:, last, 0, 2])
    assert level.max() < 1e-3
    np.testing.assert_allclose(sunk.p[:, -1, 0, 2], TOP + radius, atol=2e-3)


def test_a_pipe_on_one_column_balances_while_its_middle_is_above_it_and_tips_otherwise():
    cut, radius = 0.1, 0.1
    grid = columns((4, 4))
    ahead = np.array([-0.3, -0.15, -0.06, 0.0, 0.06, 0.15, 0.3])
    """Of the middle of the chord, which is 0.2 m long, the middle of the pipe is."""
    centers = corner(4, 4, cut) + ahead[:, None] * ALONG + [0.0, 0.0, radius + 0.05]
    sunk = sink_one(grid, radius, centers, ALONG, seconds=5.0, wide=True)
    tilt = np.arcsin(np.clip(sunk.axis[:, -1, 0, 2], -1.0, 1.0))
    carried = np.abs(ahead) < cut
    assert np.abs(tilt[carried]).max() < 0.01
    np.testing.assert_allclose(sunk.force_n[carried, -20:].sum(axis=2), MASS * G, rtol=2e-3)
    # The heavy end sinks.
    assert np.all(np.sign(tilt[~carried]) == -np.sign(ahead[~carried]))
    assert np.abs(tilt[~carried]).min() > 0.2


@pytest.mark.parametrize("radius", [0.1, 0.03])
@pytest.mark.parametrize("shape", ["corner", "column"])
def test_a_pipe_does_not_pass_a_column_anywhere_along_it(shape, radius):
    grid = columns((4, 4))
    along = np.array(
        [-1.4, -1.1, -0.76, -0.74, -0.4, -0.06, -0.02, 0.0, 0.03, 0.3, 0.72, 1.0, 1.46]
    )
    up = [0.0, 0.0, radius + 0.02]
    if shape == "corner":
        axis, middle = ALONG, corner(4, 4, 0.03)
    else:  # the column is below one end, or below all from a point to an end
        axis, middle = np.array([1.0, 0.0, 0.0]), np.array([4 * CELL, 4.4 * CELL, TOP])
    centers = middle - along[:, None] * axis + up
    sunk = sink_one(grid, radius, centers, axis, seconds=4.0)
    assert np.all(np.isfinite(sunk.p))
    assert least_gap(sunk, radius, grid).min() > -0.02  # of an impact at 0.8 m/s
    assert np.all(sunk.force_n.max(axis=(1, 2)) > 0.1 * MASS * G)


@pytest.mark.parametrize("radius", [0.1, 0.03])
def test_a_pipe_slides_along_itself_as_far_as_friction_lets_it(radius):
    """Ends of its pieces pass both corners that carry it."""
    length, speed = 4.5, 0.8
    grid = columns((4, 4), (5, 5))
    layout = lay_out(1, boxes=False, axis_pieces=(4,))
    bodies = pipes(1, radius, length)
    with jax.enable_x64(True):
        rock = Rock.of(jax.tree.map(jnp.asarray, grid))
        down = jnp.array([0.0, 0.0, -G])

        def slide(p, q, v):
            def step(now, _):
                *later, _ = push(layout, bodies, down, (rock, jnp.asarray(-50.0)), now)
                return tuple(later), later[0]

            return jax.lax.scan(step, (p, q, v), None, length=300)[1]

        start = corner(4, 4, 0.05) + 1.4 * ALONG + [0.0, 0.0, radius - 1.6e-3]
        v = np.concatenate([-speed * ALONG, np.zeros(3)])
        p = jax.device_get(thoroughly(slide)(start[None], turned_to(ALONG)[None], v[None]))[:, 0]
    moved = (p - start) @ -ALONG
    np.testing.assert_allclose(moved[-1], speed**2 / (2.0 * FRICTION * G), rtol=0.03)
    assert np.ptp(moved[-20:]) < 1e-4
    assert np.abs((p - start) @ ACROSS).max() < 5e-3
    assert p[:, 2].min() > start[2] - 1e-3  # no corner sinks in


def test_pipes_along_many_rocks_lie_still():
    n, pieces, length, radius = 3, 6, 9.0, 0.1
    grid = columns(*((i, j) for i in range(0, 12, 2) for j in range(12)))
    layout = lay_out(n, boxes=False, axis_pieces=(pieces,) * n)
    with jax.enable_x64(True):
        sink = thoroughly(sinking(layout, pipes(n, radius, length), grid, 5.0, every=1))
        p = np.array([[9.0 + 0.1 * i, 3.0 + 2.0 * i, TOP + radius + 0.05] for i in range(n)])
        q = np.tile(turned_to(np.array([1.0, 0.0, 0.0])), (n, 1))
        sunk = Sunk(*jax.device_get(sink(p, q)))
    last = slice(-100, None)
    force = np.stack([np.sum(sunk.force_n * (sunk.second == i), axis=1) for i in range(n)], axis=1)
    np.testing.assert_allclose(force[last], MASS * G, rtol=0.01)
    assert np.ptp(sunk.p[last, :, 2], axis=0).max() < 2e-5
    assert np.abs(sunk.axis[last, :, 2]).max() < 2e-5


def test_a_long_pipe_that_nothing_moves_looks_for_no_ground():
    layout = lay_out(2, boxes=False, axis_pieces=(0, 1))
    bodies = describe([CAPSULE, SPHERE], [[0.1, 5.0, 0.0], [0.2, 0.0, 0.0]], [1.0] * 2, [1.0] * 2)
    p = np.array([[9.0, 9.0, 2.0], [9.0, 8.0, TOP + 0.19]], np.float32)
    q = np.tile(turned_to(np.array([1.0, 0.0, 0.0])), (2, 1)).astype(np.float32)
    grid = columns(*((i, j) for i in range(12) for j in range(12)))
    hulls = tuple(jnp.asarray(part, jnp.float32) for part in NO_HULLS)
    shapes = candidates.locate_shapes(layout, hulls, bodies, p, q)
    rock = Rock.of(jax.tree.map(jnp.asarray, grid))
    touches = jax.device_get(candidates.touch_ground(layout, shapes, rock, jnp.asarray(-50.0)))
    assert set(touches.second[touches.depth_m > 0.0]) == {1}
    np.testing.assert_allclose(touches.depth_m.max(), 0.01, atol=1e-5)


@pytest.mark.parametrize("boxes", [False, True])
def test_balls_that_overlap_are_found_among_long_pipes(boxes):
    """All pipes' bounding spheres overlap those of all bodies, and the pipes touch nothing."""
    long, n = 10, 28
    kind = [CAPSULE] * long + [BOX if boxes else SPHERE, SPHERE] * ((n - long) // 2)
    size = [[0.05, 6.0, 0.0]] * long + [[0.2, 0.2, 0.2]] * (n - long)
    layout = lay_out(n, boxes=boxes, axis_pieces=(8,) * long)
    bodies = describe(kind, size, [1.0] * n, [1.0] * n)
    p = np.zeros((n, 3), np.float32)
    p[:long, 1] = 0.2 * np.arange(long)
    p[long:, 0], p[long:, 2] = np.linspace(-4.0, 4.0, n - long), 2.0
    p[long + 1] = p[long] + [0.35, 0.0, 0.0]
    q = np.tile(turned_to(np.array([1.0, 0.0, 0.0])), (n, 1)).astype(np.float32)
    q[long:] = [1.0, 0.0, 0.0, 0.0]
    hulls = tuple(jnp.asarray(part, jnp.float32) for part in NO_HULLS)
    touches = jax.device_get(
        jax.jit(
            lambda p, q: mjx_contact.find_touches(
                layout, candidates.locate_shapes(layout, hulls, bodies, p, q)
            )
        )(p, q)
    )
    met = touches.depth_m > 0.0
    bodies_of = layout.shape_bodies()
    pairs = {
        frozenset(bodies_of[[i, j]].tolist())
        for i, j in zip(touches.first[met], touches.second[met], strict=True)
    }
    assert pairs == {frozenset([long, long + 1])}
    np.testing.assert_allclose(touches.depth_m.max(), 0.05, atol=1e-5)


@pytest.mark.parametrize("across", [-2.8, -0.4, 0.0, 1.7, 2.9])
def test_a_long_pipe_meets_pipes_and_boxes_anywhere_along_it(across):
    """A pipe along x; one along y and a box, which it overlaps by 1 and 2 cm."""
    layout = lay_out(3, axis_pieces=(4, 4, 1))
    size = [[0.1, 3.0, 0.0], [0.05, 3.0, 0.0], [0.2, 0.3, 0.1]]
    bodies = describe([CAPSULE, CAPSULE, BOX], size, [1.0] * 3, [1.0] * 3)
    p = np.array([[0, 0, 0], [across, 2.0, 0.14], [-across, 0.0, -0.18]], np.float32)
    q = np.array(
        [turned_to(np.eye(3)[0]), turned_to(np.eye(3)[1]), [1.0, 0.0, 0.0, 0.0]], np.float32
    )
    hulls = tuple(jnp.asarray(part, jnp.float32) for part in NO_HULLS)
    shapes = candidates.locate_shapes(layout, hulls, bodies, p, q)
    touches = jax.device_get(mjx_contact.find_touches(layout, shapes))
    bodies_of, met = layout.shape_bodies(), touches.depth_m > 0.0
    depth = {
        frozenset(bodies_of[[i, j]].tolist()): d
        for i, j, d in zip(
            touches.first[met], touches.second[met], touches.depth_m[met], strict=True
        )
    }
    expected = {frozenset([0, 1]): 0.01, frozenset([0, 2]): 0.02}
    assert depth.keys() == expected.keys()
    for pair, value in expected.items():
        np.testing.assert_allclose(depth[pair], value, atol=1e-5)
