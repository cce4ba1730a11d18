"""Plans of a team as bytes: what a file of results keeps of them, and what two of them share."""

import hashlib
import io
from collections.abc import Sequence
from typing import Any, cast

import numpy as np
from numpy.typing import ArrayLike

from angler_mjx.planning.planner import NoPlan, Path
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory

_JOINTS = ("position", "velocity", "acceleration", "degree")


def pack_arrays(**arrays: Any) -> bytes:
    """Arrays as an NPZ archive."""
    buffer = io.BytesIO()
    np.savez_compressed(buffer, **arrays)
    return buffer.getvalue()


def unpack_arrays(data: bytes) -> dict[str, np.ndarray]:
    """Arrays of an NPZ archive."""
    with np.load(io.BytesIO(data), allow_pickle=False) as archive:
        return {name: archive[name] for name in archive.files}


def pack_paths(paths: Sequence[Path | NoPlan]) -> bytes:
    """Paths of a team, without the reasons of those that are missing.

    Returns:
        An NPZ archive: ``count`` int32 [R] points of each, 0 where there is none; rows of all
        robots one after another: ``time_s`` [n] and ``position_m`` [n, 3], or for trajectories of
        joints ``position``, ``velocity``, ``acceleration`` [n, 4] and ``degree`` [n].
    """
    found_paths = [path for path in paths if not isinstance(path, NoPlan)]
    count = [0 if isinstance(path, NoPlan) else len(path.time_s) for path in paths]
    arrays = {"count": np.array(count, np.int32)}
    arrays["time_s"] = _concatenate_rows([path.time_s for path in found_paths], ())
    if any(isinstance(path, JointTrajectory) for path in found_paths):
        joints = cast(list[JointTrajectory], found_paths)
        for name in _JOINTS:
            arrays[name] = _concatenate_rows([getattr(path, name) for path in joints], ())
    else:
        lines = cast(list[Trajectory], found_paths)
        arrays["position_m"] = _concatenate_rows([path.position_m for path in lines], (3,))
    return pack_arrays(**arrays)


def unpack_paths(data: bytes) -> list[Path | None]:
    """Paths of a team; None where there is none.

    Raises:
        ValueError: these are none.
    """
    arrays = unpack_arrays(data)
    count = arrays.pop("count")
    paths: list[Path | None] = []
    at = 0
    for points in count.tolist():
        rows = slice(at, at + points)
        at += points
        if points == 0:
            paths.append(None)
            continue
        fields: dict[str, Any] = {name: values[rows] for name, values in arrays.items()}
        if "position" in fields:
            still = np.zeros(len(VEHICLE_JOINTS), bool)
            path: Any = JointTrajectory(
                joints=VEHICLE_JOINTS, commanded=cast(Any, ~still), found=_found_flag(), **fields
            )
        else:
            path = Trajectory(found=_found_flag(), **fields)
        paths.append(path)
    return paths


def compute_digest(data: bytes) -> str:
    """Hexadecimal, of the numbers of plans that were packed: the same plans, the same digest."""
    hasher = hashlib.sha256()
    for name, values in sorted(unpack_arrays(data).items()):
        hasher.update(f"{name} {values.dtype} {values.shape} ".encode())
        hasher.update(np.ascontiguousarray(values).tobytes())
    return hasher.hexdigest()


def points_m(path: Path) -> np.ndarray:
    """[n, 3] m, W."""
    return np.asarray(path.position_m if isinstance(path, Trajectory) else path.position[:, :3])


def _found_flag() -> Any:
    return np.asarray(True)


def _concatenate_rows(parts: Sequence[ArrayLike], empty: tuple[int, ...]) -> np.ndarray:
    if not parts:
        return np.zeros((0, *empty), np.float32)
    return np.concatenate([np.asarray(part) for part in parts])
