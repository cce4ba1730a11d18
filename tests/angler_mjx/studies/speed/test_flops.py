import jax
import jax.numpy as jnp
import pytest
from jax.experimental import pallas as pl

from angler_mjx.studies.speed import flops

X = jnp.ones(100)


def test_an_operation_counts_once_for_each_element():
    assert flops.count_operations(lambda x: jnp.sin(x) * x + 1.0, X).flops == 300


def test_comparisons_selections_integers_and_copies_count_nothing():
    def function(x):
        return jnp.where(x > 0.5, x[::-1], x), jnp.arange(100) + 1

    assert flops.count_operations(function, X).flops == 0


def test_a_scan_counts_as_often_as_it_runs():
    def function(x):
        return jax.lax.scan(lambda c, _: (c * 2.0 + 1.0, None), x, length=7)[0]

    counted = flops.count_operations(function, X)
    assert counted.flops == 7 * 200
    assert "at least" not in counted.how


def test_scans_in_scans_multiply():
    def inner(x):
        return jax.lax.fori_loop(0, 3, lambda _, c: c * c, x)

    def function(x):
        return jax.lax.scan(lambda c, _: (inner(c), None), x, length=5)[0]

    assert flops.count_operations(function, X).flops == 15 * 100


def test_an_open_loop_counts_once_and_is_told():
    def function(x):
        return jax.lax.while_loop(lambda c: jnp.sum(c) < 1e6, lambda c: c * 2.0, x)

    counted = flops.count_operations(function, X)
    # 100 products, and the 99 sums of the question whether to go on.
    assert counted.flops == 199
    assert "at least" in counted.how


def test_what_nobody_uses_and_what_was_computed_before_is_left_out():
    def function(x):
        unused = jnp.exp(x)
        del unused
        return jnp.sin(x) + jnp.sin(x)

    assert flops.count_operations(function, X).flops == 200


def test_different_powers_are_not_taken_for_the_same():
    # x^2 is one product, x^3 two; their sum one more.
    assert flops.count_operations(lambda x: x**2 + x**3, X).flops == 400


def test_the_cheaper_branch_counts():
    def function(x):
        return jax.lax.cond(x[0] > 0, lambda x: x * 2.0 + x, lambda x: x + 1.0, x)

    found = flops.count_operations(function, X)
    assert found.flops == 100
    assert found.how.startswith("at least")


def test_agrees_with_xla_where_there_is_no_loop():
    def function(x, a):
        y = x @ a + jnp.sum(x, axis=0) * 3.0
        return y / 1.7 - x

    a = jnp.ones((20, 20))
    theirs = jax.jit(function).lower(a, a).compile().cost_analysis()["flops"]
    # Not quite: XLA may trade a division by a constant for a product, which counts the same.
    assert flops.count_operations(function, a, a).flops == pytest.approx(theirs, rel=0.01)


def test_a_kernel_is_not_looked_into():
    def kernel(x, y):
        y[...] = x[...] * 2.0

    def function(x):
        return pl.pallas_call(kernel, out_shape=jax.ShapeDtypeStruct(x.shape, x.dtype))(x)

    counted = flops.count_operations(function, X)
    assert counted.flops is None
    assert "pallas_call" in counted.how
