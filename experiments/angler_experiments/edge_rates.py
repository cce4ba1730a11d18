"""Rate of the compiled check of a team's edges, on one core.

    python -m angler_experiments.edge_rates reef_fleet

Edges of three kinds in the worlds of a scenario: between two random points of the cube, between two
free states anywhere in it, and from a free state 1 to 3 m on for each robot, as a tree grows. All
at once, and one after another from Python. Moving obstacles are fixed at their positions at t = 0.
"""

import time
from collections.abc import Callable, Iterator

import jax
import numpy as np
import tyro

from angler_mjx.planning.build_problem import build_problem
from angler_mjx.planning.host.edges import EdgeChecker
from angler_mjx.planning.problem import Problem, ProblemSettings
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.information import Information

REPEATS = 5
HORIZON_S = 120.0


def sample_problems(scenario: str, worlds: int) -> list[Problem]:
    """Return the problems of the first worlds, with the true motion of obstacles."""
    sim = Simulator(load_scenario(scenario, worlds=worlds), tile=worlds)
    settings = ProblemSettings(
        horizon_s=HORIZON_S,
        goal_tolerance_m=sim.spec.goal_tolerance_m,
        information=Information(obstacles="truth"),
        deadline_s=5.0,
    )
    batch = jax.jit(jax.vmap(lambda world, seed: build_problem(world, seed, sim.spec, settings)))(
        sim.add_parameters(sim.worlds(0)), np.arange(worlds, dtype=np.uint32)
    )
    return [jax.tree.map(lambda x, i=i: np.asarray(x)[i], batch) for i in range(worlds)]


def iterate_edge_kinds(
    problem: Problem, checker: EdgeChecker, n: int
) -> Iterator[tuple[str, np.ndarray, np.ndarray]]:
    """Yield names of the kinds, and edges [n, 3 R] of each."""
    rng = np.random.default_rng(0)
    low, high = np.asarray(problem.lower_m, float), np.asarray(problem.upper_m, float)

    def sample_states(count: int) -> np.ndarray:
        return rng.uniform(low, high, (count, checker.robots, 3))

    def sample_free_states() -> np.ndarray:
        free_states: list[np.ndarray] = []
        while sum(map(len, free_states)) < n:
            states = sample_states(4 * n)
            free_states.append(states[checker.states(states)])
        return np.concatenate(free_states)[:n]

    start = sample_free_states()
    direction = rng.normal(size=start.shape)
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    near = start + direction * rng.uniform(1.0, 3.0, (n, checker.robots, 1))
    for name, a, b in (
        ("anywhere", sample_states(n), sample_states(n)),
        ("free to free", start, sample_free_states()),
        ("1 to 3 m", start, near),
    ):
        yield name, a.reshape(n, -1), b.reshape(n, -1)


def median_seconds(call: Callable[[], object]) -> float:
    """Return the median time of a call after a first call."""
    call()
    durations = []
    for _ in range(REPEATS):
        start_s = time.perf_counter()
        call()
        durations.append(time.perf_counter() - start_s)
    return float(np.median(durations))


def measure_rates(checker: EdgeChecker, a: np.ndarray, b: np.ndarray) -> tuple[float, float, float]:
    """Return the fraction of free edges, edges/s at once, and edges/s one after another."""
    rows, ends, check = list(a[: len(a) // 4]), list(b[: len(a) // 4]), checker.edge_flat
    flat = (a.reshape(len(a), -1, 3), b.reshape(len(b), -1, 3))
    batch_s = median_seconds(lambda: checker.edges(*flat))
    sequential_s = median_seconds(lambda: [check(p, q) for p, q in zip(rows, ends, strict=True)])
    return float(checker.edges(*flat).mean()), len(a) / batch_s, len(rows) / sequential_s


def main(
    scenario: tyro.conf.Positional[str] = "reef_fleet", worlds: int = 4, n: int = 100_000
) -> None:
    """Print a row for each world and kind.

    Args:
        scenario: name of a shipped scenario, or a file.
        worlds: number of its worlds.
        n: number of edges of each kind.
    """
    print("world | kind | free | edges/s at once | edges/s one by one")
    for number, problem in enumerate(sample_problems(scenario, worlds)):
        checker = EdgeChecker(problem, moving="at_start")
        for name, a, b in iterate_edge_kinds(problem, checker, n):
            free_fraction, batch_rate, sequential_rate = measure_rates(checker, a, b)
            print(
                f"{number} | {name} | {free_fraction:.3f} | {batch_rate:.3g} | "
                f"{sequential_rate:.3g}",
                flush=True,
            )


if __name__ == "__main__":
    tyro.cli(main)
