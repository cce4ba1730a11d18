"""The current over time in a replay: arrows on a level lattice at the height of the fleet."""

import numpy as np
import rerun as rr

from angler_mjx.report.viewing.entities.scenery import ARROW_S, DOT, rgba, times
from angler_mjx.report.viewing.scene import ReplayScene
from angler_mjx.world.slices import Slices, through

_STILL_MPS = 1e-3
"""Slower water has no arrows."""
_USUAL, _LONGEST = 0.8, 1.5
"""Lengths of arrows in spacings of the lattice: at most points no longer, and nowhere."""


def log_flow(recording: rr.RecordingStream, scene: ReplayScene, path: str) -> float:
    """Log the current of a world, with a label that tells its greatest speed on the lattice.

    Args:
        recording: where to.
        scene: the world.
        path: of the entity; there is none where the water is still.

    Returns:
        Length of arrows, as the time in which the water goes it, s.
    """
    if not scene.environment.current or not scene.robots:
        return ARROW_S
    p_m = np.stack([robot.p_m for robot in scene.robots], axis=1)
    ends_s = np.array([robot.end_time_s for robot in scene.robots])
    found = through(scene.environment, scene.time_s, p_m, scene.time_s[:, None] < ends_s)
    speed = np.where(found.wet, np.linalg.norm(found.velocity_mps, axis=-1), np.nan)
    if not np.nanmax(speed, initial=0.0) > _STILL_MPS:
        return ARROW_S
    usual, fastest = np.nanquantile(speed, 0.9), np.nanmax(speed)
    scale_s = found.spacing_m * float(min(_USUAL / usual, _LONGEST / fastest))
    _arrows(recording, found, scale_s, path)
    low, _ = scene.bounds_m
    corner = np.tile(low, (len(found.time_s), 1))
    corner[:, 2] = found.point_m[:, 0, 2]
    look = rr.Points3D.from_fields(radii=[DOT], colors=[rgba("#9fd3ee")], show_labels=True)
    recording.log(f"{path}/speed", look, static=True)
    told = [f"current, up to {np.nanmax(row, initial=0.0):.2f} m/s" for row in speed]
    recording.send_columns(
        f"{path}/speed",
        [times(found.time_s)],
        rr.Points3D.columns(positions=corner, labels=told),
    )
    return scale_s


def _arrows(recording: rr.RecordingStream, found: Slices, scale_s: float, path: str) -> None:
    """Arrows whose middles are the points of the lattice that lie in water."""
    vectors, count = scale_s * found.velocity_mps, found.wet.sum(axis=1)
    look = rr.Arrows3D.from_fields(colors=[rgba("#dceffa")], radii=[0.028 * found.spacing_m])
    recording.log(path, look, static=True)
    origins = (found.point_m - 0.5 * vectors)[found.wet]
    recording.send_columns(
        path,
        [times(found.time_s)],
        [
            *rr.Arrows3D.columns(origins=origins).partition(count),
            *rr.Arrows3D.columns(vectors=vectors[found.wet]).partition(count),
        ],
    )
