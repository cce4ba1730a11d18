"""Cost of a current from a file: one scenario with it, and with three vortices instead.

    python -m angler_experiments.ocean.speed --worlds 65536

Flies `reef_fleet` with both currents by turns and prints vehicle-steps per second and their ratio.
"""

import argparse
import json
import tempfile
import time
from pathlib import Path

import jax
import numpy as np

from angler_experiments.ocean import headland
from angler_mjx.files import JsonTable
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.state import World, WorldState

VORTICES: JsonTable = {"type": "vortices", "count": 3, "peak_speed_mps": [0.1, 0.3]}


def build_simulation(
    name: str, current: JsonTable, worlds: int
) -> tuple[Simulator, World, WorldState]:
    """Build a compiled simulator of `reef_fleet` in a current, with its worlds and their state."""
    world_table = load_scenario(name).world.model_dump(mode="json", exclude_none=True)
    table = {**world_table, "currents": [current]}
    scenario = load_scenario(
        name, world=table, worlds=worlds, engine="fused", time={"record_hz": 0.0}
    )
    simulator = Simulator(scenario, tile=worlds)
    simulator.compile()
    sampled_worlds = simulator.worlds()
    return simulator, sampled_worlds, simulator.reset(sampled_worlds)


def time_segment(
    simulator: Simulator, worlds: World, state: WorldState
) -> tuple[float, WorldState]:
    """Return the wall time of a segment, and the state after it."""
    start_s = time.perf_counter()
    next_state, _, running = simulator.advance(worlds, state)
    jax.block_until_ready(running)
    return time.perf_counter() - start_s, next_state


def compare_currents(name: str, worlds: int, repeats: int) -> dict[str, object]:
    """Return medians of both, measured by turns."""
    with tempfile.TemporaryDirectory() as folder:
        path = headland.write_dataset(Path(folder) / "headland.nc")
        grid: JsonTable = {"type": "grid", "file": str(path)}
        currents = {"vortices": VORTICES, "grid": grid}
        flights = {
            kind: build_simulation(name, current, worlds) for kind, current in currents.items()
        }
        times: dict[str, list[float]] = {kind: [] for kind in flights}
        for _ in range(repeats + 1):
            for kind, (simulator, sampled_worlds, state) in flights.items():
                durations, next_state = time_segment(simulator, sampled_worlds, state)
                flights[kind] = (simulator, sampled_worlds, next_state)
                times[kind].append(durations)
    simulator = flights["grid"][0]
    steps = simulator.segment_steps * simulator.spec.physics_steps * worlds
    steps *= len(simulator.scenario.members())
    steps_per_s = {
        kind: steps / float(np.median(durations[1:])) for kind, durations in times.items()
    }
    return {
        "device": jax.devices()[0].device_kind,
        "kernels": simulator.kernels,
        "worlds": worlds,
        "vehicle_steps_per_s": steps_per_s,
        "ratio": steps_per_s["grid"] / steps_per_s["vortices"],
    }


def main() -> None:
    """Run the measurement of the command line."""
    parser = argparse.ArgumentParser(description="What a current of a file costs.")
    parser.add_argument("--scenario", default="reef_fleet")
    parser.add_argument("--worlds", type=int, default=65536)
    parser.add_argument("--repeats", type=int, default=7)
    arguments = parser.parse_args()
    print(
        json.dumps(
            compare_currents(arguments.scenario, arguments.worlds, arguments.repeats), indent=2
        )
    )


if __name__ == "__main__":
    main()
