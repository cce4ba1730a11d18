"""Calls of kernels within JAX programs: interpreted here, and lowered for CUDA."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.cuda import kernel_call, nvrtc

WIDTH, ROWS = 64, 3


@pytest.fixture
def sources(monkeypatch):
    """Sources that are compiled for a device that is not here, without NVRTC."""
    seen = []

    def begin(source, architecture, folder):
        seen.append(source)
        done = nvrtc.Future()
        done.set_result(f"// PTX {len(seen)}")
        return done

    monkeypatch.setattr(nvrtc, "begin_compilation", begin)
    monkeypatch.setattr(kernel_call, "_architecture", lambda: "compute_90")
    return seen


def plain(lane, row, factor, values):
    at = row * WIDTH + lane
    values[at] = values[at] * factor[row] + 1.0


def run(factor, values, **options):
    (after,) = kernel_call.call_lanes(
        plain, [factor], [values], width=WIDTH, rows=ROWS, block=32, **options
    )
    return after


FACTOR = np.array([2.0, 3.0, 5.0], np.float32)
VALUES = np.arange(WIDTH * ROWS, dtype=np.float32)


def test_interpreted_lanes_are_those_of_numpy():
    after = jax.jit(lambda f, v: run(f, v, interpret=True))(FACTOR, VALUES)
    np.testing.assert_array_equal(after, VALUES * np.repeat(FACTOR, WIDTH) + 1)


def test_a_call_is_lowered_with_its_ptx_grid_and_aliases(sources):
    text = (
        jax.jit(lambda f, v: run(f, v))
        .trace(FACTOR, VALUES)
        .lower(lowering_platforms=("cuda",))
        .as_text()
    )
    (call,) = re.findall(r"stablehlo.custom_call @__gpu\$xla.gpu.ptx.*", text)
    for part in (
        "grid_x = 2 : i32",
        "grid_y = 3 : i32",
        "block_x = 32 : i32",
        'kernel_type = "ptx"',
        "// PTX",
        "operand_index = 1",
    ):
        assert part in call
    assert len(set(sources)) == 1


def greatest(n):
    """Return a kernel of n lanes: the largest number, and where it first stands."""

    def kernel(_, row, source, largest, first):
        lane = jnp.arange(n, dtype=jnp.int32)
        value = source[lane]
        largest[0] = jnp.max(value)
        kernel_call.wait_for_lanes()
        first[0] = jnp.min(jnp.where(value == largest[0], lane, n))

    return kernel


def find_greatest(values, **options):
    shapes = [jax.ShapeDtypeStruct((1,), jnp.float32), jax.ShapeDtypeStruct((1,), jnp.int32)]
    return kernel_call.call_block(
        greatest(values.shape[0]),
        [values],
        shapes,
        n_lanes=values.shape[0],
        lanes_per_thread=2,
        **options,
    )


def test_interpreted_blocks_solve_each_problem_of_a_batch():
    values = np.random.default_rng(0).normal(size=(4, 2, 64)).astype(np.float32)
    solve = jax.vmap(jax.vmap(lambda v: find_greatest(v, interpret=True)))
    largest, first = jax.jit(solve)(values)
    np.testing.assert_array_equal(largest[..., 0], values.max(axis=-1))
    np.testing.assert_array_equal(first[..., 0], values.argmax(axis=-1))


@pytest.mark.parametrize("batch", [(), (4,), (4, 3)])
def test_problems_of_a_batch_are_rows_of_the_grid(sources, batch):
    solve = find_greatest
    for _ in batch:
        solve = jax.vmap(solve)
    values = np.zeros((*batch, 64), np.float32)
    traced = jax.jit(solve).trace(values)
    text = traced.lower(lowering_platforms=("cuda",)).as_text()
    (call,) = re.findall(r"stablehlo.custom_call @__gpu\$xla.gpu.ptx.*", text)
    assert f"grid_y = {np.prod(batch, dtype=int)} : i32" in call
    assert "block_x = 32 : i32" in call
    assert [x.shape for x in traced.out_info] == [(*batch, 1)] * 2
    assert sources[0].count("row * ") == 3, "each problem has its part of each array"


def test_what_a_batch_shares_is_repeated(sources):
    def both(values, shared):
        return find_greatest(values + 0 * shared)

    text = (
        jax.jit(jax.vmap(both, in_axes=(0, None)))
        .trace(np.zeros((5, 64), np.float32), np.zeros(64, np.float32))
        .lower(lowering_platforms=("cuda",))
        .as_text()
    )
    assert "grid_y = 5 : i32" in text
