"""Numbers, names and sources as vehicle files hold them."""

import re

import numpy as np

from angler_mjx.robot.importing.foreign_vehicle import ForeignVehicle
from angler_mjx.robot.importing.rigid_groups import Group

SMALLEST_SHAPE_M = 1e-3
"""Shapes that fit into a ball of this radius are no hull."""


def round_vector(vector: np.ndarray, digits: int = 12) -> list[float]:
    """Return numbers with so many digits, and those below 1e-12 as zero."""
    return [0.0 if abs(x) < 1e-12 else float(f"{float(x):.{digits}g}") for x in np.asarray(vector)]


def round_number(value: float) -> float:
    """Return a number with 12 digits."""
    return float(f"{float(value):.12g}") + 0.0


def inertia_rows(inertia_kgm2: np.ndarray) -> list[float] | list[list[float]]:
    """Return three diagonal values, or rows where there are others above rounding."""
    inertia = (inertia_kgm2 + inertia_kgm2.T) / 2
    inertia = np.where(np.abs(inertia) < 1e-9 * np.max(inertia), 0.0, inertia)
    if np.all(inertia == np.diag(np.diag(inertia))):
        return [round_number(x) for x in np.diag(inertia)]
    return [[round_number(x) for x in row] for row in inertia]


def to_name(text: str) -> str:
    """Return a text as a name of a vehicle file: letters, digits, underscores, hyphens."""
    name = re.sub(r"[^A-Za-z0-9_\-]+", "_", text).strip("_")
    return name[:64] or "unnamed"


def source_of(what: str, vehicle: ForeignVehicle, group: Group) -> str:
    """Return the source of a group's numbers, with lines of at most three of its bodies."""
    bodies = [vehicle.bodies[name] for name in group.poses]
    heavy = sorted(bodies, key=lambda body: -body.mass_kg)
    lines = [f"{body.name} ({(body.inertial or body.element).location})" for body in heavy[:3]]
    more = f" and {len(bodies) - 3} more links" if len(bodies) > 3 else ""
    return f"{what} {', '.join(lines)}{more}"
