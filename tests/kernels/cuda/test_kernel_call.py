"""Calls of kernels within JAX programs: interpreted here, and lowered for CUDA."""

import re

import jax
import numpy as np

from angler_kernels.cuda import kernel_call

WIDTH, ROWS = 64, 3


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


def test_a_call_is_lowered_with_its_ptx_grid_and_aliases(compiled_sources):
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
    assert len(set(compiled_sources)) == 1
