"""How fleets do when their controllers are told the truth, noise, or a filter's estimate.

The same worlds each time: those of a shipped scenario on the fused engine. Prints the table of
docs/sensors.md.
"""

from typing import Any

import jax
import numpy as np
import tyro

from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.state import Outcome

CASES: dict[str, dict[str, Any]] = {
    "truth": {},
    "noisy": {"estimate": "noisy"},
    "ekf": {"estimate": "ekf"},
    "ekf and USBL": {"estimate": "ekf", "sensors": {"usbl": {"fitted": True}}},
}
COLLISIONS = (Outcome.COLLISION_STATIC, Outcome.COLLISION_DYNAMIC, Outcome.COLLISION_ROBOT)


def fly(scenario: Scenario) -> tuple[np.ndarray, Any]:
    """Outcomes [world, robot] and samples [world, sample, robot, ...] of a tile."""
    simulator = Simulator(scenario)
    worlds = simulator.worlds()
    state, parts = simulator.reset(worlds), []
    for _ in range(simulator.segments):
        state, sample = simulator.segment(worlds, state)
        parts.append(jax.device_get(sample))
    samples = jax.tree.map(lambda *x: np.concatenate(x, axis=1), *parts)
    return np.asarray(state.tally.outcome), samples


def row(name: str, outcome: np.ndarray, samples: Any) -> str:
    """A line of the table; errors are root mean squares over samples of robots on their way."""
    on_way = samples.outcome == Outcome.RUNNING
    aim = np.linalg.norm(samples.p - samples.target_m, axis=-1)[on_way]
    cells = [name]
    cells += [f"{100 * np.mean(np.isin(outcome, x)):.0f} %" for x in (Outcome.REACHED, COLLISIONS)]
    cells.append(f"{_rms(aim):.3f}")
    if samples.belief is None:
        return f"| {' | '.join([*cells, *'----'])} |"
    off = (samples.belief.p - samples.p)[on_way]
    units = off / samples.belief.position_std_m[on_way]
    cells += [f"{_rms(np.hypot(off[:, 0], off[:, 1])):.3f}", f"{_rms(off[:, 2]):.3f}"]
    cells += [f"{np.abs(off).max():.2f}", f"{np.abs(units).max():.1f}"]
    return f"| {' | '.join(cells)} |"


def _rms(x: np.ndarray) -> float:
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
    for case, told in CASES.items():
        data = base.model_dump(mode="json")
        data["fleet"] = [{**entry, **told} for entry in data["fleet"]]
        print(row(case, *fly(Scenario.model_validate(data))), flush=True)


if __name__ == "__main__":
    tyro.cli(main)
