"""Distance of positions to a path."""

import numpy as np
from numpy.typing import NDArray

type Floats = NDArray[np.floating]


def distance_to_path(points: Floats, path: Floats) -> Floats:
    """Return the distance [n] of points [n, 3] to a path [m, 3] of straight segments."""
    if len(path) < 2:
        distances: Floats = np.linalg.norm(points - path[0], axis=1)
        return distances
    begin, piece = path[:-1], np.diff(path, axis=0)
    length = np.maximum(np.sum(piece**2, axis=1), 1e-12)
    offsets = points[:, None] - begin
    fractions = np.clip(np.sum(offsets * piece, axis=2) / length, 0.0, 1.0)
    nearest: Floats = np.min(np.linalg.norm(offsets - fractions[..., None] * piece, axis=2), axis=1)
    return nearest
