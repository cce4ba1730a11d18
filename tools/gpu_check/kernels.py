"""Kernels on random inputs: programs of their own on a GPU, readable code elsewhere.

The inputs are those of the tests, which compare both forms with plain Python, Dijkstra or SciPy on
a CPU. Each function returns arrays by name; the caller runs it on both devices and compares them.
"""

import jax
import jax.numpy as jnp
import numpy as np

from angler_kernels.programs import on_gpu

type Arrays = dict[str, np.ndarray]


def run_matching() -> Arrays:
    """Return columns [40, r] that `angler_kernels.matching.match_pairs` assigns to rows."""
    from angler_kernels.matching import match_pairs
    from tests.kernels.pairs.test_matching import lengths

    return {"column": np.asarray(jax.jit(jax.vmap(match_pairs))(jnp.array(lengths())))}


def run_pairs() -> Arrays:
    """Return jobs [40, R] that `world.tasks.pairs.shortest_first` assigns to robots."""
    from tests.angler_mjx.world.tasks.test_pairs import plain, scene

    scenes = [scene(seed) for seed in range(40)]
    inputs = {
        name: jnp.array(np.stack([inputs_of_seed[name] for inputs_of_seed in scenes]))
        for name in scenes[0]
    }
    return {
        "job": np.asarray(jax.jit(jax.vmap(lambda inputs_of_seed: plain(**inputs_of_seed)))(inputs))
    }


def run_reachable() -> Arrays:
    """Return arrival layers of space-time searches, -1 without one, and the cells they reached."""
    from angler_mjx.planning.path_search import robot_search
    from tests.angler_mjx.planning.test_search_kernel import LAYOUT, SHAPE, asked, land_at

    def search(
        origin: jax.Array,
        start: jax.Array,
        first: jax.Array,
        goal: jax.Array,
        **options: jax.Array,
    ) -> tuple[jax.Array, jax.Array, jax.Array]:
        land = land_at(origin)
        return robot_search._search_reachable(
            land, options["free"], options["balls"], (start, first), goal, options["may_stay"]
        )

    worlds = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(asked(seed) for seed in range(24)))
    history, arrival, reached = jax.jit(jax.vmap(lambda world: search(**world)))(worlds)
    is_reached, last = np.asarray(reached), np.asarray(arrival)
    columns = np.arange(LAYOUT.inner).reshape(SHAPE[0], LAYOUT.row)[:, : SHAPE[1]].ravel()
    cells = np.asarray(history)[..., columns]
    # A program writes nothing after its arrival.
    layers = np.arange(cells.shape[1])[None, :, None]
    is_past = layers > np.where(is_reached, last, cells.shape[1])[:, None, None]
    return {
        "reached": is_reached,
        "arrival": np.where(is_reached, last, -1),
        "cells": np.where(is_past, 0, cells),
    }


def run_costs_to_goal() -> Arrays:
    """Return least costs [3, nx, ny, nz] of mazes, as `planning.current` computes them."""
    from angler_mjx.planning.current import planner
    from tests.angler_mjx.planning.current.test_search_kernel import costs_of_a_maze

    cost = jnp.array(np.stack([costs_of_a_maze(seed) for seed in (1, 2, 3)]))
    goal = jnp.array([(0, 0, 0), (4, 3, 2), (8, 6, 4)], jnp.int32)
    return {"cost": np.asarray(jax.jit(planner._costs_to_goal)(cost, goal))}


def run_shortest_paths() -> Arrays:
    """Return path lengths [pair, world] in cells, as `world.difficulty` computes them."""
    from angler_kernels.bit_grid import pack_grid
    from angler_mjx.world.difficulty import shortest_paths as lengths

    random = np.random.default_rng(11)
    shape, n_world, n_pair = (7, 5, 9), 6, 4
    free = random.random((*shape, n_world)) > np.linspace(0.05, 0.5, n_world)
    cells_of_ends = [[random.integers(0, n, (n_pair, n_world)) for n in shape] for _ in range(2)]
    start, goal = (jnp.array(np.stack(end), jnp.int32) for end in cells_of_ends)
    search = jax.jit(lambda cells, a, b: lengths(cells, shape[2], a, b))
    return {"cells": np.asarray(search(pack_grid(jnp.array(free)), start, goal))}


def run_dynamics() -> Arrays:
    """Return positions, attitudes and velocities after 100 steps of free vehicles [N]."""
    from angler_mjx.sim.engines import dynamics as alone
    from angler_mjx.studies.speed.measured.free_motion import sample_states

    model = alone.build_dynamics("bluerov2_heavy", "wu2018")
    start = sample_states(jax.random.key(0), alone.BLOCK, model.vehicle.B.shape[-1])
    kernels: alone.Kernels = "cuda" if on_gpu() else "xla"
    after = jax.jit(lambda s, t: model.simulate(s, t, 100, kernels=kernels))(*start)
    return {name: np.asarray(getattr(after, name)) for name in ("p", "q", "nu")}
