"""Materials in contact: friction and restitution of materials and pairs, damping of contacts."""

from functools import cache
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, field_validator

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FileModel, format_path, parse_model, read_toml

type Numbers = NDArray[np.float64] | np.float64
"""An array, or a number where all arguments are numbers."""

MAX_DAMPING_RATIO = 5.0
"""Greatest damping ratio of a contact, that of a coefficient of restitution of 0.0093. Damping of
stiff contacts limits the time step, and a rebound at 1 % of the speed is none."""

_FILE = Path(__file__).parent / "data" / "materials.toml"
_BISECTIONS = 60
"""Halvings of an interval of `MAX_DAMPING_RATIO`, to below rounding."""


class Material(FileModel):
    """A material, under water at the speeds of vehicles."""

    name: Annotated[str, Field(min_length=1, max_length=64)]
    friction: Annotated[float, Field(ge=0, le=2)]
    """Coulomb coefficient of friction, wet, on the same material; between two materials as
    `pair_friction` has it."""
    restitution: Annotated[float, Field(ge=0, le=1)]
    """Coefficient of normal restitution in water, below 1 m/s; between two materials as
    `pair_restitution` has it."""
    source: Annotated[str, Field(min_length=1)]
    """Source of the numbers; estimates are named so."""


class _MaterialFile(FileModel):
    """A file of materials."""

    material: Annotated[tuple[Material, ...], Field(min_length=1, max_length=256)]

    @field_validator("material")
    @classmethod
    def _check_distinct(cls, value: tuple[Material, ...]) -> tuple[Material, ...]:
        names = [material.name for material in value]
        repeated = sorted({name for name in names if names.count(name) > 1})
        if repeated:
            raise ValueError(f"name {format_value(repeated[0])} is there twice; rename one")
        return value


def load_materials(path: Path | str | None = None) -> dict[str, Material]:
    """Read a file of materials, by name.

    Args:
        path: TOML file with a table ``[[material]]`` for each; the shipped file if None.

    Raises:
        ConfigError: the file cannot be read or has faults (all are listed).
    """
    return dict(_load_shipped()) if path is None else _read_materials(Path(path))


def find_material(name: str) -> Material:
    """Return a shipped material by name.

    Raises:
        ConfigError: there is no material of that name; lists those that exist.
    """
    materials = _load_shipped()
    if name not in materials:
        raise ConfigError(
            f"unknown material {format_value(name)}; there is {', '.join(sorted(materials))}"
        )
    return materials[name]


def pair_friction(a: ArrayLike, b: ArrayLike) -> Numbers:
    """Return the coefficient of friction [...] of two materials, the geometric mean of theirs.

    It is symmetric, gives a material on itself its coefficient, and no friction where one has none.
    A slippery material remains slippery on a rough one, which neither an arithmetic mean nor the
    greater of the two would give. The shipped coefficients are chosen for this rule.

    Args:
        a: [...] coefficient of one material on itself.
        b: [...] coefficient of the other.
    """
    friction: Numbers = np.sqrt(np.asarray(a, float) * np.asarray(b, float))
    return friction


def pair_restitution(a: ArrayLike, b: ArrayLike) -> Numbers:
    """Return the coefficient of restitution [...] of two materials, the smaller of theirs.

    In an impact both bodies bear the same force, and the softer and more dissipative one takes most
    of the deformation and of the loss: a steel frame does not rebound from sand.

    Args:
        a: [...] coefficient of one material.
        b: [...] coefficient of the other.
    """
    restitution: Numbers = np.minimum(np.asarray(a, float), np.asarray(b, float))
    return restitution


def restitution_of_damping(damping_ratio: ArrayLike) -> Numbers:
    """Return the coefficient of restitution [...] of a linear contact that never pulls.

    The contact is a spring and a damper in parallel between two masses. It ends where its force
    falls to zero, while the spring is still compressed (Schwager and Poeschel, Granular Matter 9,
    2007). Their three cases are one: with the damping ratio z,

        e = exp(-2 z arccos(z) / sqrt(1 - z^2)),  z < 1,
        e = exp(-2 z arcosh(z) / sqrt(z^2 - 1)),  z > 1,

    and exp(-2) between the two. The coefficient is 1 at z = 0, falls with z, and nears 1 / (4 z^2).

    Args:
        damping_ratio: [...] >= 0, c / (2 sqrt(k m)) of damping c, stiffness k and reduced mass m.
    """
    z = np.asarray(damping_ratio, float)
    square = np.abs((1.0 - z) * (1.0 + z))
    angle = np.where(z < 1.0, np.arccos(np.minimum(z, 1.0)), np.arccosh(np.maximum(z, 1.0)))
    ratio = np.where(square > 0.0, angle / np.sqrt(np.where(square > 0.0, square, 1.0)), 1.0)
    restitution: Numbers = np.exp(-2.0 * z * ratio)
    return restitution


def damping_ratio(restitution: ArrayLike) -> Numbers:
    """Return the damping ratio [...] of a linear contact that has a coefficient of restitution.

    The inverse of `restitution_of_damping`, by bisection: 0 at 1, and at most `MAX_DAMPING_RATIO`,
    which all coefficients below 0.0093 get, 0 among them.

    Args:
        restitution: [...] coefficients from 0 to 1.

    Raises:
        ConfigError: a coefficient is not between 0 and 1.
    """
    e = np.asarray(restitution, float)
    is_wrong = ~((e >= 0.0) & (e <= 1.0))
    if np.any(is_wrong):
        raise ConfigError(
            f"restitution: {float(e[is_wrong].flat[0]):g} is no coefficient of restitution; "
            "give a number from 0 to 1"
        )
    low, high = np.zeros_like(e), np.full_like(e, MAX_DAMPING_RATIO)
    for _ in range(_BISECTIONS):
        middle = 0.5 * (low + high)
        is_above = restitution_of_damping(middle) > e
        low, high = np.where(is_above, middle, low), np.where(is_above, high, middle)
    return np.where(e == 1.0, 0.0, high)[()]


@cache
def _load_shipped() -> dict[str, Material]:
    return _read_materials(_FILE)


def _read_materials(path: Path) -> dict[str, Material]:
    file = parse_model(_MaterialFile, read_toml(path), source=format_path(path))
    return {material.name: material for material in file.material}
