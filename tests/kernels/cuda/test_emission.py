"""Emitted C, compiled here, against the same function in JAX."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import lanes
from angler_kernels.cuda import kernel_call
from angler_kernels.cuda.emission import emit_kernel, write_number

N = 64


def emit(kernel, arrays, constants):
    """Return the code of a kernel of NumPy arrays."""
    n = kernel_call.TRACED_LANES
    with lanes.use_instructions(kernel_call.INSTRUCTIONS):
        closed = kernel_call._trace(kernel, n, arrays)
    return emit_kernel(
        "kernel", closed, kernel_call._describe(arrays, constants), lanes=n, threads=N
    )


@pytest.fixture
def evaluate(run_source):
    """Evaluate a function of lanes by emitted C; and by JAX."""

    def run(function, *inputs, out=np.float32):
        def kernel(lane, row, *refs):
            *sources, target = refs
            target[lane] = function(*(ref[lane] for ref in sources))

        ours = np.zeros(N, out)
        arrays = [*inputs, ours]
        code = emit(kernel, arrays, len(inputs))
        run_source(code.text, arrays, constants=len(inputs), blocks=2, threads=N // 2)
        return ours, np.asarray(function(*map(jnp.asarray, inputs)))

    return run


EXACT = {
    "sum": lambda x: x + 0.1,
    "difference": lambda x: 0.3 - x,
    "negative": lambda x: -x,
    "largest": lambda x: jnp.maximum(x, 0.25),
    "smallest": lambda x: jnp.minimum(0.25, x),
    "clipped": lambda x: jnp.clip(x, -1.0, 2.0),
    "size": jnp.abs,
    "sign": jnp.sign,
    "floor": jnp.floor,
    "ceiling": jnp.ceil,
    "to even": jnp.round,
    "away from zero": lambda x: jax.lax.round(x, jax.lax.RoundingMethod.AWAY_FROM_ZERO),
    "remainder": lambda x: jax.lax.rem(x, jnp.float32(0.7)),
    "chosen": lambda x: jnp.where(x > 0.0, x, -2.0),
    "of three": lambda x: jax.lax.select_n((x > 0).astype(jnp.int32) * 2, x, x + 1, x + 2),
    "cube": lambda x: x**3,
    "power 7": lambda x: x**7,
    "inverse square": lambda x: 1.0 / (x * x),
    "root": lambda x: jnp.sqrt(jnp.abs(x)),
    "infinite": lambda x: jnp.where(x > 0, jnp.inf, -jnp.inf),
    "not a number": lambda x: jnp.where(x > 0, jnp.nan, x),
}


@pytest.mark.parametrize("name", EXACT)
def test_equal_to_jax_to_the_bit(evaluate, numbers, name):
    if name == "inverse square":  # the device's own reciprocal, here an exact one
        numbers = np.where(np.abs(numbers) < 1e-15, 1.0, numbers).astype(np.float32)
    ours, theirs = evaluate(EXACT[name], numbers)
    np.testing.assert_array_equal(ours, theirs)


@pytest.mark.parametrize(
    "function",
    [jnp.exp, jnp.sin, jnp.cos, jnp.tanh, jnp.arctan, jnp.log1p, jnp.expm1, jnp.exp2, jnp.cbrt],
)
def test_functions_are_those_of_jax(evaluate, numbers, function):
    inputs = np.clip(np.nan_to_num(numbers), -0.9, 20).astype(np.float32)
    ours, theirs = evaluate(function, inputs)
    np.testing.assert_allclose(ours, theirs, rtol=2e-6, atol=1e-7)


def test_two_operands_keep_their_order(evaluate, numbers):
    other = np.roll(np.nan_to_num(numbers, posinf=2.0, neginf=-2.0), 5)
    for function in (jnp.arctan2, jnp.subtract, lambda a, b: jnp.power(jnp.abs(a) + 0.5, b / 9)):
        ours, theirs = evaluate(function, np.nan_to_num(numbers, posinf=3.0, neginf=-3.0), other)
        np.testing.assert_allclose(ours, theirs, rtol=2e-6, atol=1e-7)


def test_comparisons_and_logic(evaluate, numbers):
    def function(x):
        both = (x > -1.0) & (x <= 1.0) | ~(x != 0.5) ^ (x >= 2.0)
        return both & jnp.isfinite(x) | (x < -2.0) | (x == 1.0)

    ours, theirs = evaluate(function, numbers, out=np.bool_)
    np.testing.assert_array_equal(ours, theirs)


def test_whole_numbers(evaluate):
    whole = np.random.default_rng(1).integers(-(2**31), 2**31 - 1, N).astype(np.int32)
    whole[:3] = np.iinfo(np.int32).min, -1, 0

    def function(x):
        bits = jax.lax.bitcast_convert_type(x, jnp.uint32)
        shifted = jax.lax.shift_right_logical(x, 3) ^ jax.lax.shift_right_arithmetic(x, 5)
        counted = jax.lax.population_count(bits).astype(jnp.int32) + jax.lax.clz(x)
        return (x // 7) * 3 + x % 5 - shifted + (x << 2) + counted + jnp.where(x == -(2**31), 1, 0)

    ours, theirs = evaluate(function, whole, out=np.int32)
    np.testing.assert_array_equal(ours, theirs)


def test_bits_of_floats(evaluate, numbers):
    def function(x):
        bits = jax.lax.bitcast_convert_type(x, jnp.int32)
        return jax.lax.bitcast_convert_type(bits ^ (1 << 3), jnp.float32)

    ours, theirs = evaluate(function, numbers)
    np.testing.assert_array_equal(ours.view(np.int32), theirs.view(np.int32))


def test_a_lane_loops_as_long_as_it_needs(evaluate):
    """A fixed and an open loop whose variables trade places, and a branch inside."""
    inputs = np.linspace(0.1, 40.0, N).astype(np.float32)

    def function(x):
        def swap(_, state):
            a, b = state
            return b, a + 0.5

        a, b = jax.lax.fori_loop(0, 3, swap, (x, 2 * x))

        def body(state):
            value, count = state
            half = jax.lax.cond(jnp.max(value) > 8.0, lambda v: v / 2, lambda v: v - 1.0, value)
            return jnp.where(value > 1.0, half, value), jnp.where(value > 1.0, count + 1, count)

        value, count = jax.lax.while_loop(
            lambda s: lanes.any_lane(s[0] > 1.0), body, (a - b + 20.0, jnp.zeros_like(x))
        )
        return value + 100.0 * count

    ours, _ = evaluate(function, inputs)
    each = [function(jnp.asarray(x)[None])[0] for x in inputs]
    np.testing.assert_allclose(ours, np.asarray(each), rtol=1e-6)


def test_rows_and_stores_in_place(run_source):
    """Each row writes its own part; what is read first is what was there before."""
    rows, width = 3, 8
    source = np.arange(rows * width, dtype=np.float32)
    target = np.ones(rows * width, np.float32)

    def kernel(lane, row, values, out):
        at = row * width + lane
        before = out[at]
        out[at] = values[at] * 2 + before
        jax.lax.cond(row == 1, lambda: store(out, at), lambda: None)

    def store(out, at):
        out[at] = out[at] + 100.0

    code = emit(kernel, [source, target], 1)
    run_source(code.text, [source, target], constants=1, blocks=2, rows=rows, threads=width // 2)
    expected = np.arange(rows * width) * 2.0 + 1
    expected[width : 2 * width] += 100
    np.testing.assert_array_equal(target, expected)


@pytest.mark.parametrize(
    ("function", "operation"),
    [(jnp.cumsum, "cumsum"), (jnp.sort, "sort"), (lambda x: jnp.flip(x), "rev")],
)
def test_an_unknown_operation_is_named(function, operation):
    def kernel(lane, row, source, target):
        target[lane] = function(source[lane])

    with pytest.raises(lanes.UnsupportedOperationError, match=operation) as caught:
        emit(kernel, [np.zeros(N, np.float32)] * 2, 1)
    assert "test_emission.py" in caught.value.source


def test_a_constant_array_is_refused():
    table = jnp.arange(5.0)

    def kernel(lane, row, target):
        target[lane] = jnp.sum(table) + jnp.zeros(lane.shape)

    with pytest.raises(ValueError, match="constant array"):
        emit(kernel, [np.zeros(N, np.float32)], 0)


def test_numbers_are_read_back_to_the_bit():
    assert write_number(0.1, np.dtype(np.float32)) == "0x1.99999a0000000p-4f"
    assert write_number(-0.0, np.dtype(np.float32)) == "(-0x0.0p+0f)"
    assert write_number(1e-40, np.dtype(np.float32)) == "0x1.16c2000000000p-133f"
    assert write_number(True, np.dtype(np.bool_)) == "true"
    assert write_number(-(2**31), np.dtype(np.int32)) == "(-2147483647 - 1)"
    assert write_number(2**32 - 1, np.dtype(np.uint32)) == "4294967295u"


def test_lines_are_indented_by_their_depth():
    """Of loops of both kinds and a branch."""

    def kernel(lane, row, source, target):
        def repeat(value):
            return jax.lax.fori_loop(0, 3, lambda _, x: 2.0 * x, value)

        def halve(value):
            half = jax.lax.cond(row == 1, lambda v: v / 2, lambda v: v - 1.0, value)
            return jnp.where(value > 1.0, half, value)

        found = jax.lax.while_loop(lambda x: lanes.any_lane(x > 1.0), halve, source[lane])
        target[lane] = repeat(found)

    text = emit(kernel, [np.zeros(N, np.float32)] * 2, 1).text
    body = text[text.index(") {", text.index("__launch_bounds__")) :].splitlines()[1:-1]
    assert sum(line.endswith("{") for line in body) == 4
    depth = 1
    for line in body:
        depth -= line.lstrip().startswith("}")
        assert len(line) - len(line.lstrip()) == 2 * depth, line
        depth += line.endswith("{")
    assert depth == 1


def test_operations_are_counted():
    def kernel(lane, row, source, target):
        target[lane] = source[lane] * 2.0 + 1.0

    code = emit(kernel, [np.zeros(N, np.float32)] * 2, 1)
    assert code.operations == 3, "a load, a product, a sum"
