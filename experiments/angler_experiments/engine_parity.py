"""Deviation of the fused engine from mjx: whole episodes of the same worlds, in float32.

Every world is run twice: same cells, obstacles, currents, paths and fleet, another engine. All
shipped vehicles and parameter sets are sampled.

    python -m angler_experiments.engine_parity --worlds 250

A robot is counted as *within the bound* as long as its positions of the two runs differ by no more
than `bound_m`. It leaves the bound by a decision that rounding changes: an obstacle that was
touched a step later, a thruster at the edge of its dead band.
"""

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro
from numpy.typing import NDArray

from angler_experiments.shared.tracing import bound_m
from angler_mjx.robot.vehicles import library
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.state import Outcome
from angler_mjx.testing.validation.results import StudyNumber, save_result

type Array = NDArray[np.float64]


@dataclass(frozen=True, kw_only=True)
class EngineParity:
    """Comparison of the engines; [n] robots of all worlds."""

    distance_m: Array
    """[n, samples] distance of the two runs."""
    bound_m: Array
    """[samples] distance that rounding can explain."""
    outcome: NDArray[np.int32]
    """[2, n] outcomes by mjx and by fused."""
    touched: NDArray[np.int32]
    """[2, n, 2] kind and index of the touched object."""
    end_time_s: Array
    """[2, n] end times."""
    variants: NDArray[np.int32]
    """[n] vehicle and parameter set."""

    @property
    def is_within(self) -> NDArray[np.bool_]:
        """Return [n] whether a robot stays within the bound to the end."""
        is_inside: NDArray[np.bool_] = np.all(self.distance_m <= self.bound_m, axis=1)
        return is_inside

    @property
    def is_same(self) -> NDArray[np.bool_]:
        """Return [n] whether both episodes have the same outcome, with the same object."""
        is_alike: NDArray[np.bool_] = (self.outcome[0] == self.outcome[1]) & np.all(
            self.touched[0] == self.touched[1], axis=1
        )
        return is_alike


def all_vehicles_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario with two robots of each shipped ROV, which sample any of its sets."""
    fleet = [
        {
            "vehicle": vehicle,
            "count": 2,
            "parameter_mix": dict.fromkeys(library.load_vehicle(vehicle).parameter_sets, 1.0),
        }
        for vehicle in library.list_rovs()
    ]
    return Scenario.model_validate({**scenario.model_dump(), "fleet": fleet})


def compare_engines(scenario: Scenario, tile: int = 125) -> EngineParity:
    """Run all worlds of a scenario by both engines.

    Args:
        scenario: scenario with the number of worlds; the last tile is run whole.
        tile: worlds in one call.
    """
    engines = [
        Simulator(scenario.model_copy(update={"engine": name}), tile=tile)
        for name in ("mjx", "fused")
    ]
    parts = [_run_tile(engines, first) for first in range(0, scenario.worlds, tile)]
    runs = [[part[k] for part in parts] for k in range(2)]
    p, outcome, touched, end = (
        np.stack([np.concatenate([run[i] for run in side]) for side in runs]) for i in range(4)
    )
    simulator = engines[0]
    steps = (
        np.arange(p.shape[2], dtype=np.float64)
        * simulator.steps_per_sample
        * simulator.spec.physics_steps
    )
    return EngineParity(
        distance_m=np.linalg.norm(p[0] - p[1], axis=2),
        bound_m=bound_m(steps, float(np.abs(p).max())),
        outcome=outcome,
        touched=touched,
        end_time_s=end,
        variants=np.concatenate([part[2] for part in parts]),
    )


def _run_tile(
    engines: list[Simulator], first: int
) -> tuple[tuple[np.ndarray, ...], tuple[np.ndarray, ...], np.ndarray]:
    """Run one tile by mjx and by fused; return both and the variants, [n] robots leading."""
    worlds = engines[0].worlds(first)
    runs = []
    for simulator in engines:
        worlds = simulator.adopt(worlds)
        state, samples = simulator.reset(worlds), []
        for _ in range(simulator.segments):
            state, sample = simulator.segment(worlds, state)
            samples.append(np.asarray(sample.p, np.float64))
        p = np.moveaxis(np.concatenate(samples, axis=1), 2, 1)  # [W, R, samples, 3]
        tally = state.tally
        runs.append(
            tuple(
                np.asarray(x).reshape(-1, *x.shape[2:])
                for x in (
                    p,
                    tally.outcome,
                    np.stack([tally.touched, tally.touched_index], axis=-1),
                    tally.end_time_s,
                )
            )
        )
    return runs[0], runs[1], np.asarray(worlds.variant).ravel()


def format_report(parity: EngineParity, names: list[str]) -> str:
    """Format the numbers for people."""
    is_within, is_same = parity.is_within, parity.is_same
    max_distance_m = parity.distance_m.max(axis=1)
    lines = [
        f"{is_same.size} robots; bound at the end {parity.bound_m[-1]:.1e} m",
        f"within the bound to the end: {is_within.sum()}; greatest distance among them "
        f"{max_distance_m[is_within].max(initial=0.0):.1e} m, median "
        f"{np.median(max_distance_m):.1e} m",
        f"other outcome or other thing touched: {np.sum(~is_same)}; "
        f"of those within the bound: {np.sum(~is_same & is_within)}",
        f"ends at another step: {np.sum(parity.end_time_s[0] != parity.end_time_s[1])}; "
        f"of those within the bound: "
        f"{np.sum((parity.end_time_s[0] != parity.end_time_s[1]) & is_within)}",
    ]
    for outcome in Outcome:
        count = [int(np.sum(side == outcome)) for side in parity.outcome]
        if any(count):
            lines.append(f"{outcome.name.lower()}: mjx {count[0]}, fused {count[1]}")
    for i, name in enumerate(names):
        is_variant = parity.variants == i
        if is_variant.any():
            lines.append(
                f"{name}: {is_variant.sum()} robots, {np.sum(is_within & is_variant)} within the "
                "bound, "
                f"{np.sum(~is_same & is_variant)} with another outcome"
            )
    return "\n".join(lines)


def result_numbers(parity: EngineParity, size: str) -> dict[str, StudyNumber]:
    """Return the numbers that are compared between versions; counts in robots.

    Args:
        parity: comparison of the two runs.
        size: size of the runs, for the keys.
    """
    max_distance_m = parity.distance_m.max(axis=1)
    other_end = parity.end_time_s[0] != parity.end_time_s[1]
    counts = {
        "other_outcome": np.sum(~parity.is_same),
        "beyond_the_bound": np.sum(~parity.is_within),
        "other_end": np.sum(other_end),
    }
    study_numbers = {
        f"{size}.{name}": StudyNumber(value=float(count), unit="robots", worse="count")
        for name, count in counts.items()
    }
    median = StudyNumber(value=float(np.median(max_distance_m)), unit="m", worse="rounding")
    return {**study_numbers, f"{size}.median": median}


def to_markdown(parity: EngineParity) -> str:
    """Format the numbers for the page."""
    is_within, is_same = parity.is_within, parity.is_same
    max_distance_m = parity.distance_m.max(axis=1)
    other_end = parity.end_time_s[0] != parity.end_time_s[1]
    bound_m, within_m = parity.bound_m[-1], max_distance_m[is_within].max(initial=0.0)
    rows = {
        "robots": f"{is_same.size:,}",
        "another outcome, or another thing touched": f"{np.sum(~is_same):,}",
        "episode ends at another control step": f"{np.sum(other_end):,}",
        f"positions within the bound ({bound_m:.1e} m at the end)": f"{is_within.sum():,}",
        "greatest distance of a robot, median": f"{np.median(max_distance_m):.1e} m",
        "greatest distance among those within": f"{within_m:.1e} m",
        "greatest distance of all": f"{max_distance_m.max():.1e} m",
    }
    for outcome in Outcome:
        count = [int(np.sum(side == outcome)) for side in parity.outcome]
        if any(count):
            rows[f"{outcome.name.lower()}: mjx, fused"] = f"{count[0]:,}, {count[1]:,}"
    lines = ["| | found |", "| --- | ---: |", *(f"| {k} | {v} |" for k, v in rows.items())]
    return "\n".join(lines)


def main(
    scenario: str = "reef_fleet",
    worlds: int = 250,
    seconds: float = 120.0,
    json: Path | None = None,
) -> EngineParity:
    """Run the same worlds by mjx and by fused, and report their deviation.

    Args:
        scenario: name of a shipped scenario, or path of a file; the fleet is replaced.
        worlds: number of worlds.
        seconds: length of the episodes.
        json: file for the result, as `angler validate` reads it.
    """
    tile = math.gcd(worlds, 125)
    chosen = all_vehicles_scenario(
        load_scenario(scenario, worlds=worlds, time={"horizon_s": seconds})
    )
    parity = compare_engines(chosen, tile)
    names = [" ".join(kind) for kind in Simulator(chosen, tile=tile).variants()]
    print(format_report(parity, names))
    if json is not None:
        size = f"{worlds}_worlds_{seconds:g}_s"
        save_result(json, result_numbers(parity, size), to_markdown(parity))
    return parity


if __name__ == "__main__":
    tyro.cli(main)
