"""Functions of one body on lanes against ``vmap`` of the same functions, in float64."""

from functools import partial
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import clearance, current_field, lanes, quaternion, rigid_body, thruster
from angler_kernels.lanes import folding
from angler_kernels.lanes.transform import RULES

from ...angler_mjx.compiling import quickly

W = 64
# The same operations in another order: sums of a hundred terms of order one to a hundred.
RTOL, ATOL = 1e-12, 1e-12


@pytest.fixture(autouse=True)
def _float64():
    with jax.enable_x64(True):
        yield


def on_lanes(function, *args):
    return lanes.join(lanes.apply(function, *lanes.split(args)))


@pytest.fixture
def assert_same(deviation):
    return partial(compare, deviation)


def compare(deviation, function, *args):
    """``function`` of one body on lanes and by ``vmap`` of [W, ...] arguments."""
    args = jax.tree.map(jnp.asarray, args)
    ours = quickly(partial(on_lanes, function))(*args)
    theirs = quickly(jax.vmap(function))(*args)
    assert jax.tree.structure(ours) == jax.tree.structure(theirs)
    for x, y in zip(jax.tree.leaves(ours), jax.tree.leaves(theirs), strict=True):
        assert x.dtype == y.dtype
        # A result that is the same for all bodies comes without lanes.
        x = np.broadcast_to(x, y.shape) if x.ndim == y.ndim - 1 else x
        deviation.close("lanes.one_body", x, y, rtol=RTOL, atol=ATOL)


def normal(*shape, seed=0):
    return np.random.default_rng(seed).normal(size=(W, *shape))


def integers(high, *shape, seed=0):
    return np.random.default_rng(seed).integers(0, high, (W, *shape)).astype(np.int32)


def _newton(x):
    """Steps that depend on the body: from none to about twenty."""
    return jax.lax.while_loop(
        lambda c: c[0] > 1.0, lambda c: (0.7 * c[0], c[1] + 1, c[2] * c[0]), (x[0] ** 4, 0, x)
    )


@jax.custom_jvp
def _cube(x):
    return x**3


_cube.defjvp(lambda x, dx: (_cube(x[0]), 3 * x[0] ** 2 * dx[0]))


@jax.custom_vjp
def _square(x):
    return x**2


_square.defvjp(lambda x: (x**2, x), lambda x, g: (2 * x * g,))


CASES = {
    "broadcast_in_dim": (lambda x: x[:, None] * jnp.ones((3, 4)) + x[None, :3, None], [(3,)]),
    "reshape": (lambda x: x.reshape(2, 6).reshape(3, 2, 2), [(3, 4)]),
    "squeeze": (lambda x: jnp.squeeze(x, 1), [(3, 1, 2)]),
    "slice": (lambda x: jax.lax.slice(x, (0, 1), (3, 5), (2, 3)), [(3, 5)]),
    "concatenate": (lambda x, y: jnp.concatenate([x, y, x], axis=1), [(3, 2), (3, 4)]),
    "stack": (lambda x, y: jnp.stack([x, y, x + y], axis=-1), [(3, 2), (3, 2)]),
    "unstack": (lambda x: jnp.unstack(x, axis=1), [(3, 2)]),
    "split": (lambda x: jnp.split(x, [1, 4], axis=1), [(2, 5)]),
    "transpose": (lambda x: jnp.transpose(x, (2, 0, 1)), [(2, 3, 4)]),
    "iota": (lambda x: x * jax.lax.broadcasted_iota(jnp.int32, (2, 3), 1), [(2, 3)]),
    "reduce_sum": (lambda x: (x.sum((0, 2)), x.sum(1), x.sum()), [(2, 3, 4)]),
    "reduce_max": (lambda x: (x.max((0, 2)), x.max()), [(2, 3, 4)]),
    "reduce_min": (lambda x: (x.min((0, 2)), x.min()), [(2, 3, 4)]),
    "reduce_and": (lambda x: (jnp.all(x > -1, 1), jnp.all(x > -2)), [(3, 4)]),
    "reduce_or": (lambda x: (jnp.any(x > 1, 1), jnp.any(x > 2)), [(3, 4)]),
    "jit": (lambda x: jax.jit(lambda y: jnp.sin(y) + y)(x), [(3,)]),
    "custom_jvp_call": (_cube, [(3,)]),
    "custom_vjp_call": (_square, [(3,)]),
    "while": (_newton, [(3,)]),
    "scan": (lambda x: jax.lax.fori_loop(0, 5, lambda i, y: y * jnp.cos(y) + i, x), [(3,)]),
    "select_n": (lambda x, y: jnp.where(x > y, x, jnp.where(y > 1, 2.0, y)), [(3,), (3,)]),
    "clamp": (lambda x: jnp.clip(x, -0.5, 0.25), [(3,)]),
    "convert_element_type": (lambda x: (10 * x).astype(jnp.int32).astype(float), [(3,)]),
    "scalars": (lambda x, y: (jnp.arctan2(x, y), x % y, -x, jnp.floor(y)), [(), ()]),
}


def primitives(function, *args):
    """Names of the operations of a function, inner ones included."""
    found = set()

    def visit(jaxpr):
        for eqn in jaxpr.eqns:
            found.add(eqn.primitive.name)
            for value in jax.tree.leaves(eqn.params, is_leaf=lambda x: hasattr(x, "jaxpr")):
                inner = getattr(value, "jaxpr", value)
                if hasattr(inner, "eqns"):
                    visit(inner)

    visit(jax.make_jaxpr(function)(*args).jaxpr)
    return found


@pytest.mark.parametrize("name", CASES)
def test_operations(name, assert_same):
    function, shapes = CASES[name]
    args = [normal(*shape, seed=i) for i, shape in enumerate(shapes)]
    if name in RULES:
        assert name in primitives(function, *(x[0] for x in args))
    assert_same(function, *args)


def _pick_row(x, i):
    return jax.lax.dynamic_slice(x, (i, jnp.int32(1)), (1, 2))


def test_picks_at_places_that_differ_between_bodies(assert_same):
    assert_same(_pick_row, normal(5, 4), integers(5))
    assert_same(lambda x, i: x[i[0], i[1]], normal(3, 4), integers(3, 2))


def test_every_rule_is_tested():
    elsewhere = {"dynamic_slice", "gather", "expand_dims"}
    assert set(RULES) - set(CASES) - elsewhere <= {"pjit"}  # the name of "jit" in older versions


@pytest.mark.parametrize(
    ("name", "function"),
    [
        ("sort", lambda x: jnp.sort(x)),
        ("cond", lambda x: jax.lax.cond(x[0] > 0, lambda: x, lambda: -x)),
        ("cumsum", lambda x: jnp.cumsum(x)),
        ("rev", lambda x: x[::-1]),
        ("dot_general", lambda x: jnp.outer(x, x) @ jnp.outer(x, x)),
        ("argmin", lambda x: jnp.argmin(x)),
        ("scatter", lambda x: x.at[1].set(2.0)),
        ("gather", lambda x: x[jnp.array([0, 2])]),
        ("scan", lambda x: jax.lax.scan(lambda c, y: (c + y, c), 0.0, x)),
    ],
)
def test_what_it_cannot_do_is_named(name, function):
    with pytest.raises(NotImplementedError, match=name):
        on_lanes(function, jnp.asarray(normal(3)))


def random_body(seed=0):
    """Arguments of `rigid_body.water_wrench` for W bodies with full matrices."""
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(W, 6, 6))
    q = rng.normal(size=(W, 4))
    return {
        "M_A": half @ half.swapaxes(1, 2),
        "D_l": rng.uniform(1, 9, (W, 6)),
        "D_q": rng.uniform(1, 90, (W, 6)),
        "volume": rng.uniform(0.005, 0.02, W),
        "p_cb": 0.1 * rng.normal(size=(W, 3)),
        "height": rng.uniform(0.2, 0.4, W),
        "z": rng.uniform(-0.4, 0.2, W),  # some in air, some half in the water
        "q": q / np.linalg.norm(q, axis=1, keepdims=True),
        "nu": rng.normal(size=(W, 6)),
        "v_c": 0.5 * rng.normal(size=(W, 3)),
        "Dv_c": 0.2 * rng.normal(size=(W, 3)),
    }


def test_water_wrench(assert_same):
    def wrench(body):
        return rigid_body.water_wrench(**body, density=1000.0, gravity=9.81)

    assert_same(wrench, random_body())


def test_damped_velocity(assert_same):
    body = random_body()
    inertia = body["M_A"] + 10 * np.eye(6)
    forces = [normal(6, seed=i) for i in range(3)]
    step = partial(rigid_body.advance_damped_velocity, dt=0.01)
    assert_same(step, body["nu"], normal(6, seed=9), inertia, body["D_l"], body["D_q"], *forces)


def test_pose_and_quaternions(assert_same):
    body = random_body(1)
    q, other = body["q"], random_body(2)["q"]
    step = partial(rigid_body.advance_pose, dt=0.01)
    assert_same(step, normal(3), q, body["nu"], normal(6, seed=5))
    assert_same(quaternion.multiply, q, other)
    assert_same(quaternion.to_matrix, q)
    assert_same(quaternion.rotate_inverse, q, normal(3))
    assert_same(quaternion.exp, np.concatenate([normal(3)[:32], 1e-9 * normal(3)[32:]]))


def test_thruster_in_a_table_in_memory(assert_same):
    """A table of each body, as `Table` and as lanes, against ``vmap``."""
    rows = np.sort(np.round(normal(33), 1), axis=1)  # with flat stretches
    pwm = np.random.default_rng(1).uniform(1000, 2000, (W, 4))
    value = np.random.default_rng(2).uniform(-3, 3, (W, 4))

    def both(table, pwm, value):
        ahead = jax.vmap(thruster.lookup, (None, 0, None, None))(table, pwm, 1100.0, 25.0)
        back = jax.vmap(thruster.inverse_lookup, (None, 0, None, None))(table, value, 1100.0, 25.0)
        return ahead, back

    flat = jnp.asarray(rows).ravel()
    table = lanes.LookupTable(lambda at: flat[at], (33,), flat.dtype, base=33 * jnp.arange(W))
    pwm, value = jnp.asarray(pwm), jnp.asarray(value)
    ours = lanes.join(lanes.apply(both, table, *lanes.split((pwm, value))))
    theirs = quickly(jax.vmap(both))(jnp.asarray(rows), pwm, value)
    for x, y in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(x, y, rtol=RTOL, atol=ATOL)
    assert_same(partial(thruster.rotor_lag, dt=0.01), *(normal(4, seed=i) for i in range(2)), value)
    constants = {"settled": np.array([1.0, 0.5]), "transition": np.eye(2) / 3, "mean": np.ones(2)}
    held = {name: jnp.asarray(number) for name, number in constants.items()}
    assert_same(partial(thruster.rotor_filter, **held), normal(2, 4), value)


def test_tables_of_many_axes():
    rows = normal(6, 3, 2)
    flat = jnp.asarray(rows).transpose(1, 2, 3, 0).ravel()  # bodies side by side: step W
    table = lanes.LookupTable(
        lambda at: flat[at], (6, 3, 2), flat.dtype, base=jnp.arange(W), step=W
    )
    at = integers(6)

    def read(x, i):
        row = jax.lax.dynamic_index_in_dim(x, i, keepdims=False)
        return row, x[-1], x[2:5:2, 1], 2.0 * x, jnp.sum(x, axis=0)

    ours = lanes.join(lanes.apply(read, table, lanes.split(jnp.asarray(at))))
    theirs = jax.vmap(read)(jnp.asarray(rows), jnp.asarray(at))
    for x, y in zip(ours, theirs, strict=True):
        np.testing.assert_allclose(x, y, rtol=RTOL, atol=ATOL)


def test_hull_to_cells_a_loop_of_different_lengths(assert_same):
    rng = np.random.default_rng(3)
    centre = rng.uniform(-3, 3, (W, 3))
    a, b = centre[:, None] + rng.uniform(-0.3, 0.3, (2, W, 5, 3))
    radius = rng.uniform(0.05, 0.15, (W, 5))
    corner = np.floor(centre / 1.5) * 1.5 - 1.5
    mask = rng.integers(0, 2**27, W).astype(np.int32)
    mask[:8] = 0
    cell = np.full(W, 1.5)
    assert_same(clearance.capsules_neighbours, a, b, radius, centre, corner, mask, cell)
    assert_same(clearance.point_neighbours, centre, corner, mask, cell)


def test_distances_between_bodies(assert_same):
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=(2, W, 3, 3))
    c, d = 1.0 + rng.normal(size=(2, W, 2, 3))
    r, s = rng.uniform(0.1, 0.3, (W, 3)), rng.uniform(0.1, 0.3, (W, 2))
    assert_same(clearance.capsules_capsules, a, b, r, c, d, s)
    kind = integers(3)
    size = rng.uniform(0.2, 0.5, (W, 3))
    kinds = (clearance.SPHERE, clearance.BOX, clearance.CAPSULE)
    assert_same(
        partial(clearance.capsules_obstacle, kinds=kinds),
        *(a, b, r, rng.normal(size=(W, 3)), random_body()["q"], kind, size),
    )


def test_currents(assert_same):
    rng = np.random.default_rng(5)
    core = rng.uniform(1, 3, (W, 3))
    assert_same(
        current_field.lamb_oseen_vortices,
        *(normal(3), rng.normal(size=(W, 3, 2)), rng.normal(size=(W, 3)), core),
    )
    assert_same(
        current_field.rankine_vortices,
        *(normal(3), rng.normal(size=(W, 3, 2)), rng.normal(size=(W, 3)), core),
    )
    time = rng.uniform(-1, 40, W)
    sides = rng.uniform(5, 9, (W, 2))
    assert_same(
        current_field.double_gyre,
        *(normal(3), time, rng.normal(size=(W, 2)), sides),
        *(rng.normal(size=W), rng.uniform(0, 0.4, W), rng.uniform(5, 50, W)),
    )
    assert_same(current_field.smooth_knots, time, rng.normal(size=(W, 9, 3)), np.full(W, 5.0))


def eqns(function, *args):
    """How often each operation on lanes stands in the program."""
    jaxpr = jax.make_jaxpr(function)(*args).jaxpr
    names = [eqn.primitive.name for eqn in jaxpr.eqns]
    return SimpleNamespace(of=names.count, total=len(names))


def test_zeros_and_ones_cost_nothing():
    """A diagonal matrix of which one entry is 1 takes five products and no sum."""
    v = [jnp.asarray(x) for x in normal(6).T]
    diagonal = [jnp.asarray(x) for x in normal(6, seed=1).T]

    def times(diagonal, v):
        entries = [np.float64(0.0)] * 36
        entries[::7] = [np.float64(1.0), *diagonal[1:]]
        matrix = lanes.pack(entries, (6, 6))
        return list(lanes.apply(rigid_body.matrix_times, matrix, lanes.pack(v, (6,))))

    count = eqns(times, diagonal, v)
    assert (count.of("mul"), count.of("add")) == (5, 0)
    np.testing.assert_array_equal(
        times(diagonal, v), [v[0], *(x * y for x, y in zip(diagonal[1:], v[1:], strict=True))]
    )


@pytest.mark.parametrize("constant", [0.0, 1.0, 2.0, -1.0])
def test_constants_give_what_numbers_give(constant):
    def every(c, x):
        return c + x, x + c, c - x, x - c, c * x, x * c, c / x, x / 3 + c, jnp.where(c > 0, x, -x)

    x = normal()
    ours = lanes.join(lanes.apply(every, constant, lanes.split(jnp.asarray(x))))
    for got, wanted in zip(ours, every(constant, x), strict=True):
        np.testing.assert_allclose(np.broadcast_to(got, W), wanted, rtol=RTOL)


def test_two_operands_of_which_one_is_a_number_are_lanes():
    add = jax.jit(lambda x: folding.apply_binary(jax.lax.add_p, np.float64(2.0), x))
    np.testing.assert_array_equal(add(jnp.array([1.0, 2.0, 3.0])), [3.0, 4.0, 5.0])
    both = folding.apply_binary(jax.lax.mul_p, np.float64(2.0), np.float64(3.0))
    assert isinstance(both, np.generic)
    assert both == 6.0


def test_repeats_a_body_on_lanes():
    def body(i, tree):
        return lanes.apply(lambda i, y: {"a": y["a"] + i * y["b"], "b": -y["b"]}, i, tree)

    start = {"a": jnp.asarray(normal(2)), "b": jnp.asarray(normal(2, seed=1))}
    after = lanes.join(lanes.repeat(4, body, lanes.split(start)))
    # i b with b's sign in turn: (0 - 1 + 2 - 3) b.
    np.testing.assert_allclose(after["a"], start["a"] - 2 * start["b"], rtol=RTOL, atol=ATOL)
    np.testing.assert_allclose(after["b"], start["b"], rtol=RTOL)


def test_split_and_join_are_inverse():
    tree = {"a": jnp.asarray(normal(2, 3)), "b": jnp.asarray(integers(5))}
    back = lanes.join(lanes.split(tree))
    for name, x in tree.items():
        np.testing.assert_array_equal(back[name], x)
    flat, rebuild = lanes.flatten(lanes.split(tree))
    assert len(flat) == 7
    np.testing.assert_array_equal(lanes.join(rebuild(flat))["a"], tree["a"])


def _instructions(used):
    """Instructions that note what they were asked for."""

    def reciprocal(x):
        used.append("reciprocal")
        return 1.0 / x

    def multiply_add(a, b, c):
        used.append("multiply_add")
        return a * b + c

    return lanes.Instructions(reciprocal=reciprocal, multiply_add=multiply_add)


def _row():
    """Two rows of five lanes."""
    a = jnp.linspace(1.0, 2.0, 5, dtype=jnp.float32)
    b = jnp.linspace(3.0, 9.0, 5, dtype=jnp.float32)
    return [lanes.pack([x], ()) for x in (a, b)]


def test_division_by_a_given_reciprocal():
    """Of float32 lanes only: numbers and other types are divided as ever."""
    used = []

    def function(a, b):
        return 1.0 / b, a / b, a / 3.0, a / b.astype(jnp.float64)

    row = _row()
    expected = lanes.apply(function, *row)
    with lanes.use_instructions(_instructions(used)):
        found = lanes.apply(function, *row)
    assert used == ["reciprocal"] * 2
    for x, y in zip(found, expected, strict=True):
        # A product with a rounded reciprocal is within 1.5 ulp of the quotient, this within 0.5.
        np.testing.assert_allclose(x[()], y[()], rtol=2 * np.finfo(np.float32).eps)
    assert lanes.apply(function, *row)[0][()][0] == expected[0][()][0]
    assert len(used) == 2


@pytest.mark.parametrize(
    ("function", "fused"),
    [
        (lambda a, b: a * b + a, 1),
        (lambda a, b: a + a * b, 1),
        (lambda a, b: a * b - a, 1),
        (lambda a, b: a - a * b, 1),
        (lambda a, b: a - (-(a * b)), 1),
        (lambda a, b: b**2 - jnp.square(a), 1),
        (lambda a, b: jnp.sum(jnp.stack([a, b, 3.0 * a]) * jnp.stack([b, b, a])), 2),
        (lambda a, b: a / b + 1.0, 1),
        (lambda a, b: a + b, 0),
        (lambda a, b: (a * b).astype(jnp.float64) + a.astype(jnp.float64), 0),
        (lambda a, b: jnp.maximum(a * b, a) + b, 0),
    ],
)
def test_sums_of_products_by_a_given_instruction(function, fused):
    """A product that is added to something is multiplied there."""
    used = []
    row = _row()
    expected = lanes.apply(function, *row)[()]
    with lanes.use_instructions(_instructions(used)):
        found = lanes.apply(function, *row)[()]
    assert used.count("multiply_add") == fused
    # The same operations in another order, for terms that cancel to no less than a tenth.
    np.testing.assert_allclose(found, expected, rtol=20 * np.finfo(np.float32).eps)
