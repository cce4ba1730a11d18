"""Plans of a team as bytes: what a file of results keeps of them, and what two of them share."""

import hashlib
import io
from collections.abc import Sequence
from typing import Any, cast

import numpy as np

from angler_mjx.planning.planner import NoPlan, Path
from angler_mjx.robot.control.joint_trajectory import VEHICLE_JOINTS, JointTrajectory
from angler_mjx.robot.control.trajectory import Trajectory

_JOINTS = ("position", "velocity", "acceleration", "degree")


def packed(paths: Sequence[Path | NoPlan]) -> bytes:
    """Paths of a team, without the reasons of those that are missing.

    Returns:
        An NPZ archive: ``count`` int32 [R] points of each, 0 where there is none; rows of all
        robots one after another: ``time_s`` [n] and ``position_m`` [n, 3], or for trajectories of
        joints ``position``, ``velocity``, ``acceleration`` [n, 4] and ``degree`` [n].
    """
    there = [path for path in paths if not isinstance(path, NoPlan)]
    count = [0 if isinstance(path, NoPlan) else len(path.time_s) for path in paths]
    arrays: dict[str, Any] = {"count": np.array(count, np.int32)}
    arrays["time_s"] = _rows([path.time_s for path in there], ())
    if any(isinstance(path, JointTrajectory) for path in there):
        joints = cast(list[JointTrajectory], there)
        for name in _JOINTS:
            arrays[name] = _rows([getattr(path, name) for path in joints], ())
    else:
        lines = cast(list[Trajectory], there)
        arrays["position_m"] = _rows([path.position_m for path in lines], (3,))
    made = io.BytesIO()
    np.savez_compressed(made, **arrays)
    return made.getvalue()


def unpacked(data: bytes) -> list[Path | None]:
    """Paths of a team; None where there is none.

    Raises:
        ValueError: these are none.
    """
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in archive.files}
    count = arrays.pop("count")
    made: list[Path | None] = []
    at = 0
    for points in count.tolist():
        rows = slice(at, at + points)
        at += points
        if points == 0:
            made.append(None)
            continue
        own: dict[str, Any] = {name: values[rows] for name, values in arrays.items()}
        if "position" in own:
            still = np.zeros(len(VEHICLE_JOINTS), bool)
            kept: Any = JointTrajectory(
                joints=VEHICLE_JOINTS, commanded=cast(Any, ~still), found=_true(), **own
            )
        else:
            kept = Trajectory(found=_true(), **own)
        made.append(kept)
    return made


def digest(data: bytes) -> str:
    """Hexadecimal, of the numbers of plans that were packed: the same plans, the same digest."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        arrays = {name: archive[name] for name in sorted(archive.files)}
    made = hashlib.sha256()
    for name, values in arrays.items():
        made.update(f"{name} {values.dtype} {values.shape} ".encode())
        made.update(np.ascontiguousarray(values).tobytes())
    return made.hexdigest()


def points_m(path: Path) -> np.ndarray:
    """[n, 3] m, W."""
    return np.asarray(path.position_m if isinstance(path, Trajectory) else path.position[:, :3])


def _true() -> Any:
    return np.asarray(True)


def _rows(parts: list[Any], empty: tuple[int, ...]) -> np.ndarray:
    if not parts:
        return np.zeros((0, *empty), np.float32)
    return np.concatenate([np.asarray(part) for part in parts])
