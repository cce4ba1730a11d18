"""Programs compiled side by side, with stand-ins for what JAX gives."""

import gc
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.runs.simulator.compilation import CompiledFunction, ParallelCompiler

LONG_S = 30.0


class Lowered:
    def __init__(self, compiling):
        self.compile = compiling


class Jitted:
    kept = None

    def __init__(self, name, compiling, lowering=lambda: None):
        self.name, self._compiling, self._lowering = name, compiling, lowering

    def find(self, *example):
        return None

    def lower(self, *example):
        self._lowering()
        return Lowered(lambda: (self.name, example, self._compiling()))

    def compile(self, lowered, *example):
        return lowered.compile()


def test_the_next_is_traced_while_the_first_compiles():
    traced = threading.Event()
    # One after the other, the first would wait in vain for the second.
    first = Jitted("first", lambda: traced.wait(LONG_S))
    second = Jitted("second", lambda: True, lowering=traced.set)
    with ParallelCompiler(2) as programs:
        begun = [programs.begin(first, 1, 2), programs.begin(second, 3)]
    (one, one_s), (other, other_s) = (program.result() for program in begun)
    assert one == ("first", (1, 2), True)
    assert other == ("second", (3,), True)
    assert one_s > 0
    assert other_s > 0


def test_all_compile_at_once():
    meeting = threading.Barrier(3, timeout=LONG_S)
    with ParallelCompiler(3) as programs:
        begun = [programs.begin(Jitted(str(i), meeting.wait)) for i in range(3)]
    assert sorted(program.result()[0][2] for program in begun) == [0, 1, 2]


def test_what_the_compiler_says_comes_with_the_result():
    def refused():
        raise MemoryError("too large")

    with ParallelCompiler(2) as programs:
        begun = programs.begin(Jitted("large", refused))
        other = programs.begin(Jitted("small", lambda: True))
    with pytest.raises(MemoryError, match="too large"):
        begun.result()
    assert other.result()[0][0] == "small"


def test_a_fault_while_tracing_waits_for_what_runs():
    running, faulted, done = threading.Event(), threading.Event(), threading.Event()

    def compiling():
        running.set()
        faulted.wait(LONG_S)
        done.set()

    def fault():
        running.wait(LONG_S)
        faulted.set()
        raise TypeError("not a shape")

    def both():
        with ParallelCompiler(2) as programs:
            programs.begin(Jitted("first", compiling))
            programs.begin(Jitted("second", lambda: True, lowering=fault))

    with pytest.raises(TypeError, match="not a shape"):
        both()
    assert done.is_set()


@pytest.mark.parametrize("ahead", [False, True])
def test_a_program_may_be_a_part_of_another(ahead):
    """Its compiler options are refused by JAX inside any trace, and so is an executable."""
    x = jnp.arange(3.0)
    cube = CompiledFunction(lambda x: x**3)
    if ahead:
        cube.keep(cube.lower(x).compile())
    expected = np.arange(3.0) ** 3
    np.testing.assert_allclose(cube(x), expected)
    np.testing.assert_allclose(jax.jit(lambda x: cube(x) + 1.0)(x), expected + 1.0)
    np.testing.assert_allclose(jax.jit(lambda: cube(x) + 1.0)(), expected + 1.0)
    np.testing.assert_allclose(jax.grad(lambda x: cube(x).sum())(x), 3 * np.arange(3.0) ** 2)
    np.testing.assert_allclose(jax.vmap(cube)(jnp.stack([x, x])), np.stack([expected, expected]))
    repeated = jax.lax.fori_loop(0, 2, lambda _, x: cube(x), jnp.array([2.0, 1.0, 0.5]))
    np.testing.assert_allclose(repeated, [512.0, 1.0, 0.5**9])
    assert jax.eval_shape(cube, x).shape == cube.shape(x).shape == (3,)
    assert "pow" in str(jax.make_jaxpr(cube)(x))


class _Traced:
    """Records whether Python collects garbage while it is traced."""

    kept = None

    def __init__(self, error=None):
        self.enabled, self.error = [], error

    def find(self, x):
        return None

    def compile(self, lowered, x):
        return lowered.compile()

    def lower(self, x):
        self.enabled.append(gc.isenabled())
        if self.error:
            raise self.error
        return jax.jit(lambda x: x + 1).lower(x)


def test_garbage_is_not_collected_while_a_program_is_traced():
    traced = _Traced()
    with ParallelCompiler(1) as programs:
        compiled, _ = programs.begin(traced, 1.0).result()
        assert gc.isenabled()
    assert traced.enabled == [False]
    assert compiled(1.0) == 2


def test_collection_goes_on_after_a_trace_that_failed():
    with pytest.raises(ValueError, match="no program"), ParallelCompiler(1) as programs:
        programs.begin(_Traced(ValueError("no program")), 1.0)
    assert gc.isenabled()


def test_collection_that_the_caller_paused_stays_paused():
    gc.disable()
    try:
        with ParallelCompiler(1) as programs:
            programs.begin(_Traced(), 1.0)
        assert not gc.isenabled()
    finally:
        gc.enable()


def test_collection_goes_on_only_when_the_last_of_two_traces_has_ended():
    first_inside, second_is_done = threading.Event(), threading.Event()

    class First(_Traced):
        def lower(self, x):
            first_inside.set()
            assert second_is_done.wait(10)
            return super().lower(x)

    first = First()
    with ParallelCompiler(1) as programs:
        thread = threading.Thread(target=programs.begin, args=(first, 1.0))
        thread.start()
        assert first_inside.wait(10)
        programs.begin(_Traced(), 1.0)
        second_is_done.set()
        thread.join()
    assert first.enabled == [False]
    assert gc.isenabled()
