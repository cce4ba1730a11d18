"""Bodies of a hull that bear by themselves at the surface, such as the floats of a catamaran.

Vehicles without them bear as one body, and have programs without these terms.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.vehicles.config import Buoyancy


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class HullBodies:
    """Bodies of one hull; rows of padding have no volume."""

    fraction: jax.Array
    """[n] of the volume."""
    offset_m: jax.Array
    """[n, 3] from the centre of buoyancy, in F."""
    height_m: jax.Array
    """[n] over which the buoyancy of each fades at the surface."""


def build_hull_bodies(buoyancy: Buoyancy) -> HullBodies | None:
    """Return the bodies of a hull; None of a hull of one body (host side).

    Volume and centre may have been varied since the file was read: the bodies keep their fractions
    and their places about the centre.
    """
    if not buoyancy.bodies:
        return None
    volume = np.array([body.volume_m3 for body in buoyancy.bodies])
    center = np.array([body.center_m for body in buoyancy.bodies])
    fraction = volume / volume.sum()
    return _to_device(
        fraction, center - fraction @ center, [body.height_m for body in buoyancy.bodies]
    )


def pad_hull_bodies(
    parts: Sequence[HullBodies | None], heights_m: Sequence[jax.Array]
) -> list[HullBodies | None]:
    """Return the bodies of the vehicles of a fleet, with equal numbers of rows; None without any.

    Args:
        parts: of each vehicle; a hull without parts is one body of itself.
        heights_m: [] height of each hull.
    """
    n = max((part.fraction.shape[0] for part in parts if part is not None), default=0)
    if n == 0:
        return list(parts)
    padded: list[HullBodies | None] = []
    for part, height in zip(parts, heights_m, strict=True):
        if part is None:
            part = _to_device(np.ones(1), np.zeros((1, 3)), [float(height)])
        more = n - part.fraction.shape[0]
        padded.append(
            _to_device(
                np.pad(part.fraction, (0, more)),
                np.pad(part.offset_m, ((0, more), (0, 0))),
                np.pad(part.height_m, (0, more), constant_values=1.0),
            )
        )
    return padded


def _to_device(
    fraction: np.ndarray, offset_m: np.ndarray, height_m: Sequence[float] | np.ndarray
) -> HullBodies:
    dtype = jnp.result_type(float)
    return HullBodies(
        fraction=jnp.asarray(fraction, dtype),
        offset_m=jnp.asarray(offset_m, dtype),
        height_m=jnp.asarray(height_m, dtype),
    )
