"""The rules of the planner's lattice, once more, in plain numpy and for every cell on its own.

Written from the words of `planning.path_search.search` and `tracing`: no packed words, no shifts,
no batch. Distances are in float64."""

import itertools
from dataclasses import dataclass

import numpy as np

STEPS = [step for step in itertools.product((-1, 0, 1), repeat=3) if any(step)]


def axes_of(step):
    return sum(map(abs, step))


def layers_of(step):
    """Half a cell a layer, rounded up."""
    return {0: 1, 1: 2, 2: 3, 3: 4}[axes_of(step)]


def cover(step):
    """Which balls count when: (layer of the step, share of the way), for all layers of a step.

    About its beginning, middle and end, each with a quarter of the step's length, so they cover
    shares 0 to 1/4, 1/4 to 3/4, 3/4 to 1; during a layer those count in which the robot then is.
    """
    n = layers_of(step)
    if n == 1:
        return [(0, 0.0)]
    spans = {0.0: (0.0, 0.25), 0.5: (0.25, 0.75), 1.0: (0.75, 1.0)}
    return [
        (k, share)
        for k in range(n)
        for share, (low, high) in spans.items()
        if low < (k + 1) / n and k / n < high
    ]


def segment_gap(a, b, points):
    """Distance of points [n, 3] from the segment a b."""
    way = b - a
    share = np.clip((points - a) @ way / max(way @ way, 1e-300), 0.0, 1.0)
    return np.linalg.norm(points - a - share[:, None] * way, axis=-1)


def taken(scene, upright):
    """Where balls are in the way: bool [4 (axes of the step), L, points on half cells].

    Args:
        scene: what is to be looked at.
        upright: whether balls are the upright cylinders around them, as the search takes them.
    """
    point = np.stack(np.meshgrid(*(np.arange(2 * n - 1) for n in scene.free.shape), indexing="ij"))
    place = scene.origin + (np.moveaxis(point, 0, -1) + 1) * 0.5 * scene.cell
    off = place[None, ..., None, :] - scene.centre[:, None, None, None]
    radius = scene.radius[:, None, None, None]
    found = []
    for axes in range(4):
        wide = radius + 0.25 * axes**0.5 * scene.cell
        if upright:
            hit = (np.hypot(off[..., 0], off[..., 1]) < wide) & (np.abs(off[..., 2]) <= wide)
        else:
            hit = np.linalg.norm(off, axis=-1) < wide
        found.append(np.any(hit & (radius >= 0.0), axis=-1))
    return np.array(found)


@dataclass(frozen=True, kw_only=True)
class Scene:
    """One robot's free space, and the balls of the others in each layer."""

    origin: np.ndarray
    cell: float
    free: np.ndarray
    """bool [nx, ny, nz]."""
    centre: np.ndarray
    """[L, R, 3]."""
    radius: np.ndarray
    """[L, R]; negative where one does not count."""
    sphere: np.ndarray
    """[4] an obstacle that stands: centre, and radius with the clearance."""

    def place(self, cell):
        return self.origin + (np.asarray(cell) + 0.5) * self.cell

    def holds(self, cell):
        return all(0 <= c < n for c, n in zip(cell, self.free.shape, strict=True))

    def ways(self):
        """(cell, step) -> cell, of every step that keeps from all that stands."""
        cells = list(itertools.product(*map(range, self.free.shape)))
        return {
            (a, step): b
            for a, step in itertools.product(cells, STEPS)
            if (b := tuple(np.add(a, step).tolist())) in cells and self.way_free(a, b)
        }

    def way_free(self, a, b):
        """All cells of the step's block are free, and its line keeps from the sphere."""
        block = itertools.product(*({x, y} for x, y in zip(a, b, strict=True)))
        near = segment_gap(self.place(a), self.place(b), self.sphere[None, :3])[0]
        return all(self.free[cell] for cell in block) and near >= self.sphere[3]

    def reached(self, ways, start, first):
        """Bool [L, nx, ny, nz]: where the robot can be at the beginning of each layer."""
        met = taken(self, upright=True)
        found = np.zeros((len(self.centre), *self.free.shape), bool)
        found[first][start] = True
        for n in range(len(found)):
            if n > 0:
                waits = found[n - 1] & self.free & ~met[0, n - 1, ::2, ::2, ::2]
                found[n] |= waits
            for (a, step), b in ways.items():
                end = n + layers_of(step)
                if end < len(found) and found[n][a] and not found[end][b]:
                    found[end][b] = clear(met, a, step, n)
        return found


def clear(met, a, step, begin):
    """Whether waiting (a step of 0) or a step from a at layer ``begin`` meets none of `taken`."""
    a, step = np.array(a), np.array(step)
    places = [(begin + k, *(2 * a + round(2 * share) * step)) for k, share in cover(step)]
    return not any(met[axes_of(step)][place] for place in places)
