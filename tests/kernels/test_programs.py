"""The choice of a program's compiler and of its threads."""

from functools import partial

import jax
import pytest

from angler_kernels.programs import BlockProgram, compiled_by


@pytest.mark.parametrize(
    ("lanes", "per_warp", "warps"),
    [(1, 64, 1), (64, 64, 1), (65, 64, 2), (2048, 64, 32), (16384, 1024, 16), (16384, 256, 32)],
)
def test_a_program_has_no_more_threads_than_a_block_can_have(lanes, per_warp, warps):
    program = BlockProgram.of(lanes, lanes_per_warp=per_warp)
    assert program.warps == warps
    assert program.lanes >= lanes
    assert program.lanes % (32 * program.warps) == 0


def test_what_jax_keeps_of_one_compiler_is_not_used_for_another():
    seen = []

    @jax.jit
    def inner(x):
        seen.append(BlockProgram.of(32).compiler)
        return x + 1

    for compiler in ("triton", "cuda", "triton", "cuda"):
        jax.jit(compiled_by(compiler, lambda x: inner(x)))(1)
    inner(1)
    assert seen == ["triton", "cuda"]


def test_a_function_with_inputs_keeps_its_name():
    def named(a, b):
        return a + b

    assert compiled_by("cuda", partial(named, 1)).__name__ == "named"
    assert compiled_by("cuda", named).__name__ == "named"
    assert compiled_by("cuda", partial(named, 1))(b=2) == 3
