"""Values in common behind barriers: what is computed stays, and where barriers come."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels import lanes
from angler_kernels.lanes import sharing


def work(x, times):
    """``times`` multiplications and additions."""
    for i in range(times):
        x = x * 0.5 + float(i)
    return x


def three(x, times):
    """Three results that have ``times`` multiplications and additions in common."""
    common = work(x, times)
    return lanes.pack([common + 1.0, common * x, common - x], (3,))


def barriers(function, *args):
    return str(jax.make_jaxpr(function)(*args)).count("optimization_barrier")


def row(function, x):
    return list(lanes.compute_shared(partial(function, x)))


X = jnp.linspace(0.1, 1.0, 64)


def test_values_and_derivatives_stay():
    def cost(x, share):
        results = lanes.compute_shared(partial(three, x, 20)) if share else three(x, 20)
        return sum(jnp.sum(jnp.sin(y)) for y in results)

    ours, theirs = (jax.value_and_grad(partial(cost, share=s))(X) for s in (True, False))
    # Sums of 192 numbers below 40, and what compilers make of products and sums: a few ulp.
    jax.tree.map(partial(np.testing.assert_allclose, rtol=1e-5), ours, theirs)


def test_holds_what_is_dear_to_repeat():
    assert barriers(partial(row, partial(three, times=20)), X) == 1


def test_repeats_what_is_cheap():
    # Two results repeat two operations: less than one array in memory costs.
    assert sharing.MEMORY_COST > 2 * 2
    assert barriers(partial(row, partial(three, times=1)), X) == 0


def test_one_result_holds_nothing():
    assert barriers(partial(row, lambda x: lanes.pack([work(x, 40)], (1,))), X) == 0


def test_numbers_are_not_held():
    assert barriers(partial(row, partial(three, times=20)), jnp.float32(1.0)) == 0


def test_goes_into_loops_branches_and_functions():
    def looped(x):
        def body(_, y):
            return jax.lax.cond(y[0][0] > 0.0, jax.jit(lambda y: list(three(y[1], 20))), list, y)

        return lanes.pack(jax.lax.fori_loop(0, 3, body, list(three(x, 0))), (3,))

    assert barriers(partial(row, looped), X) == 1
    ours, theirs = row(looped, X), list(looped(X))
    # One hundred and twenty operations, each rounded once.
    np.testing.assert_allclose(ours, theirs, rtol=1e-5)
