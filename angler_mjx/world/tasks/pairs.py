"""Pairing of robots and jobs, shortest paths first.

On a GPU one kernel reads the paths and forms the pairs: a program for each requesting robot, which
is every robot where their information differs. A program without a robot that can take a job ends
at once, and no path is ever written to memory.
"""

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from angler_kernels.matching import MAX_LANES, MatchedPairs, match_pairs
from angler_kernels.programs import use_kernels
from angler_mjx.world import routes
from angler_mjx.world.routes import Routes
from angler_mjx.world.tasks import travel
from angler_mjx.world.tasks.travel import Travel

_LANES_A_WARP = 256
"""8 for each thread: the data of a path must stay in registers."""


def shortest_first(travel: Travel, p: jax.Array, able: jax.Array, open_: jax.Array) -> jax.Array:
    """Return the job of each robot: the shortest remaining path is taken repeatedly.

    Args:
        travel: paths to places, of which the first M are the beginnings of jobs.
        p: [R, 3] positions of robots, m in W.
        able: bool [R] robots that can take a job.
        open_: bool [M] jobs that can be taken.

    Returns:
        int32 [R], -1 for none. Ties go to the robot of lower index, then to the job of
        lower index.
    """
    shape = able.shape[0], open_.shape[0]
    pairs = MatchedPairs.of(shape, lanes_per_warp=_LANES_A_WARP)
    if use_kernels() and travel.routes is not None and pairs.program.lanes <= MAX_LANES:
        return _MatchingKernel(pairs, travel.routes.words.shape).run(travel.routes, p, able, open_)
    length = travel.path_lengths_m(p, jnp.arange(shape[1], dtype=jnp.int32))
    return match_pairs(jnp.where(open_ & able[:, None], length, jnp.inf))


@dataclass(frozen=True)
class _MatchingKernel:
    pairs: MatchedPairs
    shape: tuple[int, ...]
    """Shape of `Routes.words`."""

    __name__ = "shortest_first"

    def run(self, routes: Routes, p: jax.Array, able: jax.Array, open_: jax.Array) -> jax.Array:
        """Return jobs as `shortest_first` does."""
        grid = jnp.concatenate([routes.origin_m, routes.cell_m[None]])
        flat = [x.reshape(-1) for x in (routes.words, routes.position_m, grid, p)]
        flags = [x.astype(jnp.int32) for x in (able, open_)]
        out = jax.ShapeDtypeStruct((self.pairs.rows,), jnp.int32)
        (taken,) = self.pairs.program.run(self, [*flat, *flags], [out])
        return taken

    def __call__(
        self,
        words: jax.Ref,
        position_m: jax.Ref,
        grid: jax.Ref,
        p: jax.Ref,
        able: jax.Ref,
        open_: jax.Ref,
        taken: jax.Ref,
    ) -> None:
        pairs, program = self.pairs, self.pairs.program
        row, column, real = pairs.lane_pairs
        pairs.clear_matches(taken)
        can = program.load(able, jnp.where(real, row, 0), real, 0)

        def take() -> None:
            length = self._path_lengths(words, position_m, grid, p)
            begins = program.load(open_, jnp.where(real, column, 0), real, 0)
            pairs.write_matches(jnp.where((can > 0) & (begins > 0), length, jnp.inf), taken)

        program.when(jnp.max(can) > 0, take)

    def _path_lengths(
        self, words: jax.Ref, position_m: jax.Ref, grid: jax.Ref, p: jax.Ref
    ) -> jax.Array:
        """Return the path length of each lane; values of lanes that are no pair are ignored."""
        program, (*cells, n_position) = self.pairs.program, self.shape
        row, column, real = self.pairs.lane_pairs
        origin, cell_m = [grid[axis] for axis in range(3)], grid[3]
        robot_offset, position_offset = jnp.where(real, 3 * row, 0), jnp.where(real, 3 * column, 0)
        robot_m = [program.load(p, robot_offset + axis, real, 0.0) for axis in range(3)]
        to_m = [program.load(position_m, position_offset + axis, real, 0.0) for axis in range(3)]
        cell = [
            jnp.clip(jnp.floor((x - low) / cell_m).astype(jnp.int32), 0, n - 1)
            for x, low, n in zip(robot_m, origin, cells, strict=True)
        ]
        at = ((cell[0] * cells[1] + cell[1]) * cells[2] + cell[2]) * n_position + column
        word = program.load(words, jnp.where(real, at, 0), real, routes.NO_PATH)
        length = routes.length_m(word, cell, robot_m, to_m, origin, cell_m)
        line = sum((x - to) ** 2 for x, to in zip(robot_m, to_m, strict=True))
        return jnp.where(length < jnp.inf, length, travel.DETOUR_FACTOR * jnp.sqrt(line))
