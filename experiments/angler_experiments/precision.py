"""float32 against float64: the same worlds, currents, vehicles and plans flown in both.

    python -m angler_experiments.precision --worlds 64

Runs are made in float32. This study flies every world in float64 too, from the same numbers, to
isolate the effect of float32: for rounding alone, and for the robots with another outcome, traced
to the first difference (`angler_experiments.shared.tracing`).
"""

import math
from pathlib import Path

import numpy as np
import tyro

from angler_experiments.devices_parity import ParitySettings, result_numbers, to_markdown
from angler_experiments.shared import flights, tracing
from angler_experiments.shared.flights import StudyFlight
from angler_mjx.testing.validation.results import StudyNumber, save_result


def energy_difference(single: StudyFlight, double: StudyFlight) -> float:
    """Return median relative difference of electrical energy of robots with the same outcome."""
    is_same_end = ~tracing.is_different(single, double)
    single_j, double_j = (
        single.energy_j.astype(np.float64)[is_same_end],
        double.energy_j[is_same_end],
    )
    return float(np.median(np.abs(single_j - double_j) / np.maximum(double_j, 1.0)))


def main(worlds: int = 64, seconds: float = 120.0, json: Path | None = None) -> None:
    """Fly worlds of `reef_fleet`, seed 7, in float32 and in float64, and compare.

    Args:
        worlds: number of worlds.
        seconds: length of the episodes.
        json: file for the result, as `angler validate` reads it.
    """
    scenario = ParitySettings(worlds=worlds, seconds=seconds).load()
    single, double = flights.fly_in_double(scenario, math.gcd(worlds, 128))
    physics_steps = scenario.sim_spec().physics_steps
    traces = tracing.trace_differences(single, double, scenario.time.control_dt_s, physics_steps)
    text = to_markdown(single, double, traces, ("float32", "float64"))
    fraction = energy_difference(single, double)
    text += f"\n\nElectrical energy of robots that end alike: {fraction:.1e} apart (median)."
    print(text)
    if json is not None:
        study_numbers = {
            **result_numbers(single, double, traces),
            "energy_median": _fraction_number(fraction),
        }
        size = f"{worlds}_worlds_{seconds:g}_s"
        save_result(json, {f"{size}.{key}": number for key, number in study_numbers.items()}, text)


def _fraction_number(value: float) -> StudyNumber:
    return StudyNumber(value=value, unit="of the energy", worse="rounding")


if __name__ == "__main__":
    tyro.cli(main)
