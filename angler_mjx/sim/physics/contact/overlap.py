"""Overlap of bodies at rest, by MuJoCo on the host: for checks before a run."""

from dataclasses import dataclass

import mujoco
import numpy as np
from numpy.typing import ArrayLike

from angler_mjx.world.obstacles import BOX, CAPSULE, SPHERE, Obstacles

_GEOMS = {
    SPHERE: mujoco.mjtGeom.mjGEOM_SPHERE,
    BOX: mujoco.mjtGeom.mjGEOM_BOX,
    CAPSULE: mujoco.mjtGeom.mjGEOM_CAPSULE,
}
_TOUCHING_M = 1e-6
"""Overlap up to which bodies only touch: lengths in files are decimal."""


@dataclass(frozen=True, kw_only=True)
class Overlap:
    """Two bodies that overlap, or one and the floor."""

    first: int
    """Row of the obstacle."""
    second: int | None
    """Row of the other; None for the floor."""
    depth_m: float


def find_overlaps(obstacles: Obstacles, floor_z_m: float) -> list[Overlap]:
    """Return what overlaps at t = 0 among the obstacles of a file, and with the floor.

    Args:
        obstacles: [n] rows of one world.
        floor_z_m: height of the sea floor, m, in W.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "overlap"
    kinds, exists = np.asarray(obstacles.kind), np.asarray(obstacles.exists)
    rows = np.flatnonzero(exists)
    for row in rows:
        body = spec.worldbody.add_body(
            pos=_numbers(obstacles.p0)[row], quat=_numbers(obstacles.q0)[row]
        )
        size = _numbers(obstacles.size_m)[row]
        body.add_geom(type=_GEOMS[int(kinds[row])], size=np.where(size > 0.0, size, 1e-3))
    spec.worldbody.add_geom(
        type=mujoco.mjtGeom.mjGEOM_PLANE, size=[1.0, 1.0, 1.0], pos=[0.0, 0.0, floor_z_m]
    )
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    floor = int(np.flatnonzero(model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE)[0])
    geoms = [geom for geom in range(model.ngeom) if geom != floor]
    found = []
    for i, first in enumerate(geoms):
        for j, second in [*list(enumerate(geoms))[i + 1 :], (-1, floor)]:
            depth = -mujoco.mj_geomDistance(model, data, first, second, 1.0, None)
            if depth > _TOUCHING_M:
                other = None if j < 0 else int(rows[j])
                found.append(Overlap(first=int(rows[i]), second=other, depth_m=depth))
    return found


def _numbers(values: ArrayLike) -> np.ndarray:
    return np.asarray(values, float)
