"""float32 against float64: the same worlds, currents, vehicles and plans flown in both.

    python -m angler_experiments.precision --worlds 64

Runs are made in float32. Here every world is flown in float64 too, from the same numbers, so that
what float32 costs stands by itself: for rounding alone, and for the robots whose episodes end
otherwise, traced to what differed first (`angler_experiments.shared.tracing`).
"""

import math
from pathlib import Path

import numpy as np
import tyro

from angler_experiments.devices_parity import ParitySettings, numbers, to_markdown
from angler_experiments.shared import flights, tracing
from angler_experiments.shared.flights import StudyFlight
from angler_mjx.testing.validation.results import Number, save_result


def energy(single: StudyFlight, double: StudyFlight) -> float:
    """Median relative difference of the electrical energy of robots that ended the same way."""
    same = ~tracing.different(single, double)
    ours, theirs = single.energy_j.astype(np.float64)[same], double.energy_j[same]
    return float(np.median(np.abs(ours - theirs) / np.maximum(theirs, 1.0)))


def main(worlds: int = 64, seconds: float = 120.0, json: Path | None = None) -> None:
    """Fly worlds of `reef_fleet`, seed 7, in float32 and in float64, and compare.

    Args:
        worlds: how many.
        seconds: length of the episodes.
        json: file for the result, as `angler validate` reads it.
    """
    scenario = ParitySettings(worlds=worlds, seconds=seconds).load()
    single, double = flights.fly_in_double(scenario, math.gcd(worlds, 128))
    physics_steps = scenario.sim_spec().physics_steps
    traces = tracing.trace(single, double, scenario.time.control_dt_s, physics_steps)
    text = to_markdown(single, double, traces, ("float32", "float64"))
    share = energy(single, double)
    text += f"\n\nElectrical energy of robots that end alike: {share:.1e} apart (median)."
    print(text)
    if json is not None:
        found = {**numbers(single, double, traces), "energy_median": _share(share)}
        size = f"{worlds}_worlds_{seconds:g}_s"
        save_result(json, {f"{size}.{key}": number for key, number in found.items()}, text)


def _share(value: float) -> Number:
    return Number(value=value, unit="of the energy", worse="rounding")


if __name__ == "__main__":
    tyro.cli(main)
