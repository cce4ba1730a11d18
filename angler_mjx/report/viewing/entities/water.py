"""Current over time in a replay: arrows on a level lattice at the height of the fleet."""

import numpy as np
import rerun as rr

from angler_mjx.report.plotting.scene import ReplayScene
from angler_mjx.report.viewing.entities.scenery import ARROW_S, DOT, time_column, to_rgba
from angler_mjx.world.slices import CurrentSlices, slice_flight

_STILL_MPS = 1e-3
"""Min speed of water with arrows."""
_USUAL_LENGTH, _MAX_LENGTH = 0.8, 1.5
"""Max length of arrows in lattice spacings: at most points, and at all points."""


def log_flow(recording: rr.RecordingStream, scene: ReplayScene, path: str) -> float:
    """Log the current of a world, with a label of its max speed on the lattice.

    Args:
        recording: destination.
        scene: the world.
        path: of the entity; there is none where the water is still.

    Returns:
        Length of arrows, as the time in which the water passes it, s.
    """
    if not scene.environment.current or not scene.robots:
        return ARROW_S
    p_m = np.stack([robot.p_m for robot in scene.robots], axis=1)
    ends_s = np.array([robot.end_time_s for robot in scene.robots])
    slices = slice_flight(scene.environment, scene.time_s, p_m, scene.time_s[:, None] < ends_s)
    speed = np.where(slices.wet, np.linalg.norm(slices.velocity_mps, axis=-1), np.nan)
    if not np.nanmax(speed, initial=0.0) > _STILL_MPS:
        return ARROW_S
    usual, fastest = np.nanquantile(speed, 0.9), np.nanmax(speed)
    scale_s = slices.spacing_m * float(min(_USUAL_LENGTH / usual, _MAX_LENGTH / fastest))
    _log_arrows(recording, slices, scale_s, path)
    low, _ = scene.bounds_m
    corner = np.tile(low, (len(slices.time_s), 1))
    corner[:, 2] = slices.point_m[:, 0, 2]
    points = rr.Points3D.from_fields(radii=[DOT], colors=[to_rgba("#9fd3ee")], show_labels=True)
    recording.log(f"{path}/speed", points, static=True)
    labels = [f"current, up to {np.nanmax(row, initial=0.0):.2f} m/s" for row in speed]
    recording.send_columns(
        f"{path}/speed",
        [time_column(slices.time_s)],
        rr.Points3D.columns(positions=corner, labels=labels),
    )
    return scale_s


def _log_arrows(
    recording: rr.RecordingStream, slices: CurrentSlices, scale_s: float, path: str
) -> None:
    """Log arrows centred on the lattice points that lie in water."""
    vectors, count = scale_s * slices.velocity_mps, slices.wet.sum(axis=1)
    arrows = rr.Arrows3D.from_fields(colors=[to_rgba("#dceffa")], radii=[0.028 * slices.spacing_m])
    recording.log(path, arrows, static=True)
    origins = (slices.point_m - 0.5 * vectors)[slices.wet]
    recording.send_columns(
        path,
        [time_column(slices.time_s)],
        [
            *rr.Arrows3D.columns(origins=origins).partition(count),
            *rr.Arrows3D.columns(vectors=vectors[slices.wet]).partition(count),
        ],
    )
