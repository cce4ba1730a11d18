"""Boxes around meshes of STL and OBJ files."""

import re
from pathlib import Path

import numpy as np

from angler_mjx.errors import ConfigError

MAX_MESH_BYTES = 1 << 28

_VERTEX = re.compile(rb"^\s*(?:v|vertex)\s+(\S+)\s+(\S+)\s+(\S+)", re.M)


def read_mesh_box(path: Path) -> tuple[np.ndarray, np.ndarray] | None:
    """Return the lowest and highest corner [3] of a mesh, m, or None for a format not read.

    Raises:
        ConfigError: the file cannot be read or holds no vertices.
    """
    if path.suffix.lower() not in (".stl", ".obj"):
        return None
    try:
        if path.stat().st_size > MAX_MESH_BYTES:
            raise ConfigError(f"{path}: {path.stat().st_size} bytes; {MAX_MESH_BYTES} at most")
        data = path.read_bytes()
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read ({error.strerror})") from error
    n_triangles = int.from_bytes(data[80:84], "little")
    try:
        if path.suffix.lower() == ".stl" and len(data) == 84 + 50 * n_triangles:
            records = np.frombuffer(data, np.dtype([("v", "<f4", (4, 3)), ("_", "<u2")]), offset=84)
            vertices = records["v"][:, 1:].reshape(-1, 3).astype(float)
        else:
            vertices = np.array([[float(x) for x in row] for row in _VERTEX.findall(data)])
    except ValueError as error:
        raise ConfigError(f"{path}: a vertex is no number") from error
    if not len(vertices) or not np.all(np.isfinite(vertices)):
        raise ConfigError(f"{path}: holds no vertices, or infinite ones; export the mesh again")
    return vertices.min(axis=0), vertices.max(axis=0)
