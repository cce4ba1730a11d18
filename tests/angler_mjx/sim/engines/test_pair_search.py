"""The searches with lists against the search in turn, on shapes with many equal distances."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import lanes
from angler_mjx.sim.engines.lanes import pairs as pair_search
from angler_mjx.sim.engines.lanes.search import (
    GROUP_SIZE,
    MAX_NOTED_GROUPS,
    CandidateBody,
    NearestBody,
    OtherBodies,
    Seeker,
    search_in_groups,
    search_in_turn,
)

from ...compiling import quickly

N, R, W = 45, 3, 8
"""Shapes, robots and worlds: several chunks of pairs, and more groups than a lane can note."""
FIRST = 2
"""Number of shape 0; two of the robots are shapes themselves."""
RADIUS_M = 0.5


def points(seed, rows):
    """Points [rows, W] on a lattice of 1 m: distances are equal often, and without rounding."""
    drawn = np.random.default_rng(seed).integers(0, 4, (3, rows, W)).astype(np.float32)
    return [jnp.asarray(x) for x in drawn]


def search(how, mine, theirs, limit, running, start_gap):
    """The nearest shapes; a gap is the distance along the axes, as it has no root to round."""
    one = partial(lanes.pack, shape=())
    state = (lanes.pack(theirs, (3,)), one([jnp.arange(N * W).reshape(N, W) % 2 == 0]))

    def load(index):
        rows = index
        if how is not pair_search.search_listed:
            rows = (index, np.s_[:] if jnp.ndim(index) == 0 else np.arange(W))
        p, fixed = pair_search.gather_lanes(state, rows)
        # Nothing of a shape is known by its bounding sphere alone: twice its place is its speed.
        return CandidateBody(
            p=p, reach=RADIUS_M, details=lambda: (fixed, None, [2.0 * x for x in p])
        )

    def exact(me, met):
        fixed, _, v = met.details()
        gap = sum(jnp.abs(x - y) for x, y in zip(me.p, met.p, strict=True)) - 2.0 * RADIUS_M
        return gap, fixed[()], v

    me = Seeker(
        p=lanes.pack(mine, (3,)),
        a=one([np.float32(0.0)]),
        b=one([np.float32(0.0)]),
        r=one([np.float32(0.0)]),
        radius_m=one([np.float32(RADIUS_M)]),
        running=one([running]),
        limit_m=one([jnp.full((R, W), limit, jnp.float32)]),
    )
    zero = jnp.zeros((R, W))
    start = NearestBody(
        gap=jnp.full((R, W), start_gap, jnp.float32),
        index=jnp.full((R, W), -1),
        fixed=running & False,
        v=(zero, zero, zero),
    )
    others = OtherBodies(count=N, load=load, first=FIRST)
    return how(me, others, exact, start, np.arange(R)[:, None] + 1)


@pytest.fixture(scope="module")
def searches():
    """A function of the same arguments that gives what each search finds."""
    kinds = (pair_search.search_listed, search_in_groups, search_in_turn)
    functions = [quickly(partial(search, how)) for how in kinds]
    return lambda *args: [function(*args) for function in functions]


CASES = {
    "some": (1.0, 0.6, np.inf),
    "all": (np.inf, 1.0, np.inf),
    "touching only": (-np.inf, 1.0, np.inf),
    "none": (np.inf, 0.0, np.inf),
    "one found before": (np.inf, 1.0, 2.0),
}


@pytest.mark.parametrize("case", CASES)
def test_finds_what_the_search_in_turn_finds(searches, case):
    limit, share, start_gap = CASES[case]
    running = jnp.asarray(np.random.default_rng(3).random((R, W)) < share)
    ours, grouped, in_turn = searches(points(1, R), points(2, N), limit, running, start_gap)
    # The numbers are whole and halves: nothing is rounded.
    jax.tree.map(np.testing.assert_array_equal, ours, in_turn)
    jax.tree.map(np.testing.assert_array_equal, grouped, in_turn)
    found = np.asarray(ours.index) >= 0
    assert found.any() == (case != "none")
    assert not found[~np.asarray(running)].any()
    # No robot finds itself: robots 1 and 2 are shapes 0 and 1 of these.
    assert (np.asarray(ours.index) != np.arange(R)[:, None] + 1).all()


def test_there_are_ties_and_several_chunks_and_too_many_groups():
    mine, theirs = np.stack(points(1, R)), np.stack(points(2, N))
    gaps = np.abs(mine[:, None] - theirs[:, :, None]).sum(axis=0)
    ties = np.sum(gaps == gaps.min(axis=0), axis=0) > 1
    assert ties.mean() > 0.2
    assert N * R * W > 4 * pair_search.CHUNK
    assert N > GROUP_SIZE * MAX_NOTED_GROUPS


def test_has_the_derivative_of_the_search_in_turn():
    def cost(mine, how):
        found = search(how, mine, points(2, N), np.inf, jnp.ones((R, W), bool), 3.0)
        return jnp.sum(found.gap**2 + found.v[0])

    ours, theirs = (
        quickly(jax.grad(partial(cost, how=how)))([x + 0.25 for x in points(1, R)])
        for how in (pair_search.search_listed, search_in_turn)
    )
    # Multiples of a quarter.
    jax.tree.map(np.testing.assert_array_equal, ours, theirs)
    assert np.count_nonzero(ours[0]) > R * W / 2
