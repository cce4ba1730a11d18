"""The same questions as `edges`, of the hulls themselves at their headings: tighter, and slower."""

from collections.abc import Callable, Sequence
from functools import partial

import numpy as np

from angler_mjx.planning.host.compiled import advancing
from angler_mjx.planning.host.compiled.packed import Moving, pack_problem
from angler_mjx.planning.problem import Problem


class HullChecker:
    """Checks states and edges of the team's hulls: capsules, turned about z by the heading.

    On an edge positions and headings change linearly and together.
    A state or edge nearer than ``margin_m`` plus `compiled.advancing.TOLERANCE_M` is not free.

    Attributes:
        robots: number of checked robots, R.
        edge_flat: one edge, from and to float64 [4 R] (contiguous); the fastest entry.
    """

    robots: int
    edge_flat: Callable[[np.ndarray, np.ndarray], bool]

    def __init__(
        self,
        problem: Problem,
        *,
        margin_m: float = 0.0,
        robots: Sequence[int] | None = None,
        moving: Moving = "ignored",
    ) -> None:
        """Make a problem ready; arguments and errors are those of `edges.EdgeChecker`."""
        self._packed = pack_problem(problem, margin_m, robots, moving)
        self.robots = int(self._packed.head[0])
        team = problem.team
        chosen = list(range(problem.robots) if robots is None else robots)
        parts = (team.capsule_a_m, team.capsule_b_m, np.asarray(team.capsule_r_m)[..., None])
        hull = np.concatenate([np.asarray(part, np.float64)[chosen] for part in parts], axis=-1)
        ends = np.maximum(np.hypot(*hull[..., :2].T), np.hypot(*hull[..., 3:5].T)).T
        self._hull = np.ascontiguousarray(hull)
        self._turning = (ends + hull[..., 6]).max(axis=1)
        self.edge_flat = partial(advancing.is_edge_free, *self._packed, self._hull, self._turning)

    def state(self, q: np.ndarray) -> bool:
        """Return whether the team can be at q [R, 4]: x, y, z (m, W), heading (rad)."""
        flat = self._flatten_states(q)[0]
        return self.edge_flat(flat, flat)

    def states(self, q: np.ndarray) -> np.ndarray:
        """Return `state` of each of q [n, R, 4]; bool [n]."""
        return self.edges(q, q)

    def edge(self, a: np.ndarray, b: np.ndarray) -> bool:
        """Return whether the team can go from a [R, 4] to b [R, 4]."""
        return self.edge_flat(self._flatten_states(a)[0], self._flatten_states(b)[0])

    def edges(self, a: np.ndarray, b: np.ndarray) -> np.ndarray:
        """Return `edge` of each of a and b [n, R, 4]; bool [n]."""
        return advancing.are_edges_free(
            *self._packed,
            self._hull,
            self._turning,
            self._flatten_states(a),
            self._flatten_states(b),
        )

    def clearances(self, q: np.ndarray) -> np.ndarray:
        """Return the least distance of any hull to anything at each of q [n, R, 4]; float64 [n], m.

        Exact up to the least radius of the robots' spheres; a lower bound beyond.
        """
        return advancing.team_clearances(*self._packed, self._hull, self._flatten_states(q))

    def _flatten_states(self, q: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(q, np.float64).reshape(-1, 4 * self.robots)
