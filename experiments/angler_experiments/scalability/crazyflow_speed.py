"""Crazyflow by itself, for its line in the figure: to be run by a Python that has it.

    python -m venv crazyflow-venv && crazyflow-venv/bin/pip install crazyflow
    crazyflow-venv/bin/python crazyflow_speed.py --out cost.jsonl

One drone in each world with its default dynamics and control, without commands, as in the table of
its README. This program knows nothing of the rest of the project, so that its environment needs
nothing of it, and adds rows of the same form to a file.
"""

import argparse
import importlib
import importlib.metadata
import json
import statistics
import sys
import time
from pathlib import Path

STEPS, REPEATS = 100, 10
SIZES = {"gpu": (1024, 16_384, 262_144, 1_048_576), "cpu": (64, 256, 1024)}


def measure_rate(worlds: int, steps: int, repeats: int) -> dict[str, object]:
    """Measure one row.

    Args:
        worlds: number of worlds with one drone each.
        steps: physics steps in one call.
        repeats: timed calls, after two untimed ones.
    """
    jax = importlib.import_module("jax")
    flow = importlib.import_module("crazyflow.sim")
    backend = jax.default_backend()
    sim = flow.Sim(n_worlds=worlds, n_drones=1, device=backend)
    rates = []
    for i in range(repeats + 2):
        sim.reset()
        jax.block_until_ready(sim.data)
        start_s = time.perf_counter()
        sim.step(steps)
        jax.block_until_ready(sim.data)
        rates += [worlds * steps / (time.perf_counter() - start_s)] * (i > 1)
    return {
        "workload": "scalability/dynamics",
        "inside": f"{steps} steps of crazyflow {importlib.metadata.version('crazyflow')} in one "
        "call: default dynamics and control, one drone in each world",
        "worlds": worlds,
        "robots": 1,
        "unit": "vehicle-steps/s",
        "median": statistics.median(rates),
        "low": min(rates),
        "high": max(rates),
        "repeats": repeats,
        "compile_s": None,
        "engine": "crazyflow",
        "kernels": "xla",
        "device": jax.devices()[0].device_kind,
        "extra": {"size": float(worlds)},
    }


def main() -> None:
    """Measure each number of worlds and add its row."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--worlds", type=int, nargs="*", default=None)
    arguments = parser.parse_args()
    # Without a handler MuJoCo appends its warnings to MUJOCO_LOG.TXT in the working folder.
    importlib.import_module("mujoco").set_mju_user_warning(
        lambda message: print(message, file=sys.stderr)
    )
    backend = importlib.import_module("jax").default_backend()
    for worlds in arguments.worlds or SIZES["gpu" if backend == "gpu" else "cpu"]:
        row = measure_rate(worlds, STEPS, REPEATS)
        with arguments.out.open("a", encoding="utf-8") as file:
            file.write(json.dumps(row) + "\n")
        print(f"{worlds:,} worlds: {row['median']:.3g} drone-steps/s", flush=True)


if __name__ == "__main__":
    main()
