"""Shapes in the docstrings of kernels, executed: what they take, and what they give.

Every public function of `angler_kernels` that takes arrays alone is read. The letters of its
shapes get sizes of their own, so that no two axes are alike by chance, and it is traced.
"""

import importlib
import inspect
import pkgutil
import re

import jax
import jax.numpy as jnp
import pytest

import angler_kernels

SHAPE = r"(?:(bool|u?int\d*) )?\[([a-z0-9_+, ]*)\]"
SIZES = (5, 7, 11, 13, 17, 19)
ARRAYS = ("jax.Array", "jax.Array | float")
UNSTATED = {
    # Of any number of axes.
    "bit_grid.pack_grid",
    "bit_grid.count_cells",
    "current_field.lamb_oseen_circulation",
    "rigid_body.advance_velocity",
    "thruster.rotor_filter",
    "thruster.rotor_lag",
    # They give a tree, `Field`, whose fields say their shapes.
    "current_field.depth_profile",
    "current_field.double_gyre",
    "current_field.lamb_oseen_vortices",
    "current_field.rankine_vortices",
    "current_field.smooth_knots",
    "current_field.tidal_current",
}
"""The only ones whose shapes are not read. A new kernel says its own."""


def public():
    for module in pkgutil.walk_packages(angler_kernels.__path__, "angler_kernels."):
        found = importlib.import_module(module.name)
        for name, function in inspect.getmembers(found, inspect.isroutine):
            if not name.startswith("_") and getattr(function, "__module__", "") == found.__name__:
                yield f"{module.name.removeprefix('angler_kernels.')}.{name}", function


def inputs(function):
    """Name -> annotation of what it takes, as written."""
    stated = inspect.signature(inspect.unwrap(function)).parameters.values()
    return {
        one.name: re.sub(r"^'|'$", "", inspect.formatannotation(one.annotation)) for one in stated
    }


def read(function):
    """Shapes of the arguments by name, and those of the result in order; None where unsaid."""
    text = inspect.getdoc(function) or ""
    taken = {}
    for name in inputs(function):
        listed = re.search(rf"^    {name}: (.*)$", text, re.M)
        stated_shape = re.match(SHAPE, listed[1]) if listed else None
        stated_shape = stated_shape or re.search(
            rf"\b{name}(?:``)? {SHAPE}", text.partition("Args:")[0]
        )
        taken[name] = stated_shape.groups() if stated_shape else None
    returned = text.partition("Returns:")[2]
    if not returned:
        returned = text.partition("\n\n")[0]
        for name in taken:
            returned = re.sub(rf"\b{name}(?:``)? {SHAPE}", "", returned)
    return taken, re.findall(SHAPE, returned)


def size(axis, sizes):
    """Of one axis: a number, a letter, or a letter and a number more."""
    letter, _, more = axis.partition("+")
    if axis.isdigit():
        return int(axis)
    return sizes.setdefault(letter.strip(), SIZES[len(sizes)]) + int(more or 0)


def shape(stated_shape, sizes):
    return tuple(size(axis.strip(), sizes) for axis in stated_shape.split(",") if axis.strip())


FUNCTIONS = {
    name: function
    for name, function in public()
    if inputs(function) and set(inputs(function).values()) <= set(ARRAYS)
}
STATED = {
    name
    for name, function in FUNCTIONS.items()
    if all(read(function)[0].values()) and read(function)[1]
}


def test_no_more_kernels_than_these_leave_a_shape_unsaid():
    assert set(FUNCTIONS) - STATED == UNSTATED


@pytest.mark.parametrize("name", sorted(STATED))
def test_a_kernel_takes_and_gives_the_shapes_that_it_says(name):
    taken, stated = read(FUNCTIONS[name])
    sizes: dict = {}
    like = {
        argument: jax.ShapeDtypeStruct(shape(stated_shape, sizes), kind or "float32")
        for argument, (kind, stated_shape) in taken.items()
    }
    found = jax.tree.leaves(jax.eval_shape(FUNCTIONS[name], **like))
    assert [leaf.shape for leaf in found] == [
        shape(stated_shape, sizes) for _, stated_shape in stated
    ]
    for leaf, (kind, _) in zip(found, stated, strict=True):
        assert not kind or leaf.dtype.name == kind


def broken(x):
    """Sum [3] of x [3, n]."""
    return x.sum(axis=0)


def test_a_docstring_that_lies_is_found_out():
    broken.__annotations__["x"] = jax.Array
    taken, stated = read(broken)
    assert (taken, stated) == ({"x": (None, "3, n")}, [("", "3")])
    sizes: dict = {}
    x = jax.ShapeDtypeStruct(shape("3, n", sizes), jnp.float32)
    assert jax.eval_shape(broken, x).shape != shape("3", sizes)
