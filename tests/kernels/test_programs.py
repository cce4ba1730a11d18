"""The choice of kernels, and of the threads of a program."""

from functools import partial

import jax
import pytest

from angler_kernels.programs import BlockProgram, use_kernels, without_kernels


@pytest.mark.parametrize(
    ("lanes", "per_warp", "warps"),
    [(1, 64, 1), (64, 64, 1), (65, 64, 2), (2048, 64, 32), (16384, 1024, 16), (16384, 256, 32)],
)
def test_a_program_has_no_more_threads_than_a_block_can_have(lanes, per_warp, warps):
    program = BlockProgram.of(lanes, lanes_per_warp=per_warp)
    assert program.warps == warps
    assert program.lanes >= lanes
    assert program.lanes % (32 * program.warps) == 0


def test_traces_with_kernels_are_not_used_without(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    seen = []

    @jax.jit
    def inner(x):
        seen.append(use_kernels())
        return x + 1

    for _ in range(2):
        jax.jit(lambda x: inner(x))(1)
        jax.jit(without_kernels(lambda x: inner(x)))(1)
    assert seen == [True, False]
    monkeypatch.setattr(jax, "default_backend", lambda: "cpu")
    assert not use_kernels()


def test_a_function_with_inputs_keeps_its_name():
    def named(a, b):
        return a + b

    assert without_kernels(partial(named, 1)).__name__ == "named"
    assert without_kernels(named).__name__ == "named"
    assert without_kernels(partial(named, 1))(b=2) == 3
