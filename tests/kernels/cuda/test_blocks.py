"""Kernels whose lanes work together: ordinary JAX, C on this machine, and lowered for CUDA."""

import re
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import lanes
from angler_kernels.cuda import kernel_call

LANES, SIZE = 128, 100
FILLED = (
    jax.ShapeDtypeStruct((1,), jnp.float32),
    jax.ShapeDtypeStruct((SIZE,), jnp.int32),
    jax.ShapeDtypeStruct((1,), jnp.int32),
)


def compute(values, offset, *, threads=64, interpret=False):
    """Return the least of values, their order plus an offset, and a sum by halves."""

    def kernel(source, shift, least, order, total):
        lane = jnp.arange(LANES, dtype=jnp.int32)
        is_value = lane < SIZE
        value = jnp.where(is_value, source[jnp.where(is_value, lane, 0)], jnp.inf)
        least[0] = jnp.min(value)
        order[jnp.where(is_value, lane, SIZE)] = lane + shift[0]
        kernel_call.wait_for_lanes()

        def add_half(k, width):
            # Lanes read what others wrote in the turn before.
            half = (width + 1) // 2
            is_added = lane + half < width
            other = order[jnp.where(is_added, lane + half, 0)]
            before = order[jnp.where(is_added, lane, 0)]
            kernel_call.wait_for_lanes()
            order[jnp.where(is_added, lane, SIZE)] = before + other
            kernel_call.wait_for_lanes()
            return half

        jax.lax.fori_loop(0, 7, add_half, jnp.int32(SIZE))
        total[0] = jnp.where(jnp.any(value == least[0]), order[0], -1)

    return kernel_call.call_block(
        kernel, [values, offset], FILLED, lanes=LANES, threads=threads, interpret=interpret
    )


def inputs(*batch):
    rng = np.random.default_rng(len(batch))
    values = rng.normal(size=(*batch, SIZE)).astype(np.float32)
    return values, rng.integers(0, 9, (*batch, 1)).astype(np.int32)


def check(results, values, offset):
    least, _, total = results
    expected = np.broadcast_to(values.min(axis=-1), least.shape[:-1])
    np.testing.assert_array_equal(least[..., 0], expected)
    expected = np.sum(np.arange(SIZE) + offset, axis=-1)
    np.testing.assert_array_equal(total[..., 0], np.broadcast_to(expected, total.shape[:-1]))


FORMS = [{"interpret": True}, {"threads": 32}, {"threads": 128}]


@pytest.mark.usefixtures("compiled_sources")
@pytest.mark.parametrize("form", FORMS)
@pytest.mark.parametrize("batch", [(), (3,), (3, 2)])
def test_each_problem_of_a_batch_is_solved(form, batch):
    solve = partial(compute, **form)
    for _ in batch:
        solve = jax.vmap(solve)
    values, offset = inputs(*batch)
    check(jax.jit(solve)(values, offset), values, offset)


@pytest.mark.usefixtures("compiled_sources")
@pytest.mark.parametrize("form", [{"interpret": True}, {"threads": 32}])
@pytest.mark.parametrize("axes", [(0, None), (None, 0)])
def test_problems_that_share_an_array_read_the_same(form, axes):
    """Along the inner axis of the batch, the outer one, or both."""
    values, offset = inputs(3, 2)
    of_values, of_offset = values[0, :2], offset[:, 0]
    inner = jax.vmap(partial(compute, **form), in_axes=axes)
    outer = jax.vmap(inner, in_axes=axes[::-1])
    if axes == (0, None):
        results = jax.jit(outer)(of_values, of_offset)
        check(results, of_values[None], of_offset[:, None])
    else:
        results = jax.jit(outer)(values[:, 0], offset[0])
        check(results, values[:, :1], offset[:1])


def test_an_axis_of_the_batch_may_be_any(compiled_sources):
    values, offset = inputs(3)
    results = jax.vmap(compute, in_axes=(1, 1), out_axes=[0, 1, 0])(values.T, offset.T)
    check([results[0], results[1].T, results[2]], values, offset)
    assert compiled_sources


def lower(function, *arrays):
    text = jax.jit(function).trace(*arrays).lower(lowering_platforms=("cuda",)).as_text()
    (call,) = re.findall(r"stablehlo.custom_call @__gpu\$xla.gpu.ptx.*", text)
    return call


def test_problems_are_blocks_of_one_call_and_nothing_is_repeated(compiled_sources):
    values, offset = np.zeros((70_000, SIZE), np.float32), np.zeros(1, np.int32)
    call = lower(jax.vmap(compute, in_axes=(0, None)), values, offset)
    for part in ("grid_x = 70000 : i32", "grid_y = 1 : i32", "block_x = 64 : i32", "// PTX"):
        assert part in call
    assert f"(tensor<70000x{SIZE}xf32>, tensor<1xi32>) ->" in call
    assert "output_operand_alias" not in call
    assert "__launch_bounds__(64)" in compiled_sources[-1]
    assert len(set(compiled_sources)) == 1, "one for all problems"


def test_a_number_that_lanes_write_is_read_before_any_goes_on(compiled_sources):
    lower(compute, *inputs())
    body = compiled_sources[-1].split('extern "C"')[1]
    # The barriers of the kernel, and one after the loads of least[0] and order[0], not of shift[0].
    assert body.count("__syncthreads();") == 3 + 2


def test_numbers_of_16_bits(compiled_sources):
    """Half floats are loaded, chosen and converted; whole numbers of 16 bits are without sign."""

    def convert(halves, words):
        def kernel(halves, words, out, counts):
            lane = jnp.arange(32, dtype=jnp.int32)
            chosen = jnp.where(lane % 2 == 0, halves[lane], jnp.float16(jnp.inf))
            out[lane] = chosen.astype(jnp.float32) * 0.5
            counts[lane] = words[lane].astype(jnp.int32) >> 5

        shapes = [jax.ShapeDtypeStruct((32,), x) for x in (jnp.float32, jnp.int32)]
        return kernel_call.call_block(kernel, [halves, words], shapes, lanes=32, threads=32)

    halves = np.linspace(-9.0, 60000.0, 32).astype(np.float16)
    words = np.linspace(0, 2**16 - 1, 32).astype(np.uint16)
    out, counts = convert(halves, words)
    expected = np.where(np.arange(32) % 2 == 0, halves.astype(np.float32) * 0.5, np.inf)
    np.testing.assert_array_equal(out, expected)
    np.testing.assert_array_equal(counts, words.astype(int) >> 5)
    assert compiled_sources


@pytest.mark.usefixtures("compiled_sources")
@pytest.mark.parametrize(
    ("function", "operation"),
    [
        (lambda x: jnp.cumsum(x), "cumsum"),
        (lambda x: x + jnp.sum(x), "reduce_sum"),
        (lambda x: x + jnp.arange(7, dtype=jnp.int32)[0], "iota"),
    ],
)
def test_an_unknown_operation_is_named(function, operation):
    def kernel(source, target):
        lane = jnp.arange(32, dtype=jnp.int32)
        target[lane] = function(source[lane])

    shape = jax.ShapeDtypeStruct((32,), jnp.int32)
    with pytest.raises(lanes.UnsupportedOperationError, match=operation) as caught:
        kernel_call.call_block(kernel, [jnp.zeros(32, jnp.int32)], [shape], lanes=32, threads=32)
    assert "test_blocks.py" in caught.value.source
