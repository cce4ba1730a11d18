"""Performance of fleets whose controllers receive the truth, noise, or a filter's estimate.

The same worlds each time: those of a shipped scenario on the fused engine. Prints the table of
docs/reference/sensors.md.
"""

import jax
import numpy as np
import tyro
from numpy.typing import ArrayLike

from angler_mjx.files import JsonTable
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import Outcome

CASES: dict[str, JsonTable] = {
    "truth": {},
    "noisy": {"estimate": "noisy"},
    "ekf": {"estimate": "ekf"},
    "ekf and USBL": {"estimate": "ekf", "sensors": {"usbl": {"fitted": True}}},
}
COLLISIONS = (Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC, Outcome.COLLISION_ROBOT)


def fly_worlds(scenario: Scenario) -> tuple[np.ndarray, Sample]:
    """Return outcomes [world, robot] and samples [world, sample, robot, ...] of a tile."""
    simulator = Simulator(scenario)
    worlds = simulator.worlds()
    state, parts = simulator.reset(worlds), []
    for _ in range(simulator.segments):
        state, sample = simulator.segment(worlds, state)
        parts.append(jax.device_get(sample))
    samples: Sample = jax.tree.map(lambda *x: np.concatenate(x, axis=1), *parts)
    return np.asarray(state.tally.outcome), samples


def format_row(name: str, outcome: np.ndarray, samples: Sample) -> str:
    """Format a line of the table; errors are root mean squares over samples of running robots."""
    is_running = samples.outcome == Outcome.RUNNING
    aim_error_m = np.linalg.norm(samples.p - samples.target_m, axis=-1)[is_running]
    cells = [name]
    cells += [f"{100 * np.mean(np.isin(outcome, x)):.0f} %" for x in (Outcome.REACHED, COLLISIONS)]
    cells.append(f"{_rms(aim_error_m):.3f}")
    if samples.belief is None:
        return f"| {' | '.join([*cells, *'----'])} |"
    estimate_error_m = (samples.belief.p - samples.p)[is_running]
    normalised_error = estimate_error_m / samples.belief.position_std_m[is_running]
    cells += [
        f"{_rms(np.hypot(estimate_error_m[:, 0], estimate_error_m[:, 1])):.3f}",
        f"{_rms(estimate_error_m[:, 2]):.3f}",
    ]
    cells += [f"{np.abs(estimate_error_m).max():.2f}", f"{np.abs(normalised_error).max():.1f}"]
    return f"| {' | '.join(cells)} |"


def _rms(x: ArrayLike) -> float:
    return float(np.sqrt(np.mean(np.square(x, dtype=np.float64))))


def main(
    scenario: tyro.conf.Positional[str] = "reef_fleet", worlds: tyro.conf.Positional[int] = 64
) -> None:
    """Print the table.

    Args:
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        worlds: Number of worlds.
    """
    base = load_scenario(scenario, engine="fused", worlds=worlds, tile=worlds)
    print(
        "| told | reached | collided | behind the aim, m | horizontal, m | depth, m | largest, m | "
        "largest, std |\n|---|---:|---:|---:|---:|---:|---:|---:|"
    )
    for case, estimate_options in CASES.items():
        data = base.model_dump(mode="json")
        data["fleet"] = [{**entry, **estimate_options} for entry in data["fleet"]]
        print(format_row(case, *fly_worlds(Scenario.model_validate(data))), flush=True)


if __name__ == "__main__":
    tyro.cli(main)
