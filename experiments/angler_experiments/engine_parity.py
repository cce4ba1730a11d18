"""How far the fused engine is from mjx: whole episodes of the same worlds, in float32.

Every world is run twice: same cells, obstacles, currents, paths and fleet, another engine. All
shipped vehicles and parameter sets are drawn.

    python -m angler_experiments.engine_parity --worlds 250

A robot is counted as *within the bound* as long as its positions of the two runs differ by no more
than `bound_m`. What takes it past the bound is a decision that rounding tips: an obstacle that was
touched a step later, a thruster at the edge of its dead band.
"""

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from angler_mjx.robot.vehicles import library
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.state import Outcome
from angler_mjx.testing.validation.results import Number, save_result

type Array = NDArray[np.float64]

STANDARD_DEVIATIONS = 5.0


@dataclass(frozen=True, kw_only=True)
class Parity:
    """What was found; [n] robots of all worlds."""

    apart_m: Array
    """[n, samples] distance of the two runs."""
    bound_m: Array
    """[samples] what rounding can explain."""
    outcome: NDArray[np.int32]
    """[2, n] by mjx and by fused."""
    touched: NDArray[np.int32]
    """[2, n, 2] what was touched, and which of these."""
    end_time_s: Array
    """[2, n]."""
    variants: NDArray[np.int32]
    """[n] which vehicle and set."""

    @property
    def within(self) -> NDArray[np.bool_]:
        """[n] robots that stay within the bound to the end."""
        inside: NDArray[np.bool_] = np.all(self.apart_m <= self.bound_m, axis=1)
        return inside

    @property
    def same(self) -> NDArray[np.bool_]:
        """[n] robots whose episodes end the same way, on the same thing."""
        alike: NDArray[np.bool_] = (self.outcome[0] == self.outcome[1]) & np.all(
            self.touched[0] == self.touched[1], axis=1
        )
        return alike


def bound_m(steps: Array, reach_m: float) -> Array:
    """How far apart rounding takes two float32 runs of the same equations.

    Both round the position once a physics step, by up to half a unit in the last place (ulp) of the
    greatest coordinate. The two errors are independent and uniform, so the difference is a random
    walk with steps of variance ulp^2 / 6: after n steps its standard deviation is ulp sqrt(n / 6).
    Five of these are allowed. Rounding of velocities and forces adds little: damping and
    the control loop take it out within seconds.

    Args:
        steps: physics steps taken.
        reach_m: greatest coordinate.
    """
    ulp = float(np.spacing(np.float32(reach_m)))
    bound: Array = STANDARD_DEVIATIONS * ulp * np.sqrt(np.maximum(steps, 1) / 6)
    return bound


def everything(scenario: Scenario) -> Scenario:
    """The scenario with two robots of each shipped vehicle, which draw any of its sets."""
    fleet = [
        {
            "vehicle": vehicle,
            "count": 2,
            "parameter_mix": dict.fromkeys(library.load(vehicle).parameter_sets, 1.0),
        }
        for vehicle in library.available()
    ]
    return Scenario.model_validate({**scenario.model_dump(), "fleet": fleet})


def compare(scenario: Scenario, tile: int = 125) -> Parity:
    """Run all worlds of a scenario by both engines.

    Args:
        scenario: with as many worlds as are wanted; those of the last tile are all run.
        tile: worlds in one call.
    """
    engines = [
        Simulator(scenario.model_copy(update={"engine": name}), tile=tile)
        for name in ("mjx", "fused")
    ]
    parts = [_tile(engines, first) for first in range(0, scenario.worlds, tile)]
    runs = [[part[k] for part in parts] for k in range(2)]
    p, outcome, touched, end = (
        np.stack([np.concatenate([run[i] for run in side]) for side in runs]) for i in range(4)
    )
    one = engines[0]
    steps = np.arange(p.shape[2], dtype=np.float64) * one.steps_per_sample * one.spec.physics_steps
    return Parity(
        apart_m=np.linalg.norm(p[0] - p[1], axis=2),
        bound_m=bound_m(steps, float(np.abs(p).max())),
        outcome=outcome,
        touched=touched,
        end_time_s=end,
        variants=np.concatenate([part[2] for part in parts]),
    )


def _tile(engines: list[Simulator], first: int) -> tuple[Any, Any, Any]:
    """One tile by mjx and by fused, and the variants; [n] robots lead."""
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


def report(parity: Parity, names: list[str]) -> str:
    """The numbers as a person reads them."""
    within, same = parity.within, parity.same
    greatest = parity.apart_m.max(axis=1)
    lines = [
        f"{same.size} robots; bound at the end {parity.bound_m[-1]:.1e} m",
        f"within the bound to the end: {within.sum()}; greatest distance among them "
        f"{greatest[within].max(initial=0.0):.1e} m, median {np.median(greatest):.1e} m",
        f"other outcome or other thing touched: {np.sum(~same)}; "
        f"of those within the bound: {np.sum(~same & within)}",
        f"ends at another step: {np.sum(parity.end_time_s[0] != parity.end_time_s[1])}; "
        f"of those within the bound: "
        f"{np.sum((parity.end_time_s[0] != parity.end_time_s[1]) & within)}",
    ]
    for outcome in Outcome:
        count = [int(np.sum(side == outcome)) for side in parity.outcome]
        if any(count):
            lines.append(f"{outcome.name.lower()}: mjx {count[0]}, fused {count[1]}")
    for i, name in enumerate(names):
        mine = parity.variants == i
        if mine.any():
            lines.append(
                f"{name}: {mine.sum()} robots, {np.sum(within & mine)} within the bound, "
                f"{np.sum(~same & mine)} with another outcome"
            )
    return "\n".join(lines)


def numbers(parity: Parity, size: str) -> dict[str, Number]:
    """What is compared from one time to the next; counts in robots.

    Args:
        parity: of the two runs.
        size: of the runs, for the keys.
    """
    greatest = parity.apart_m.max(axis=1)
    other_end = parity.end_time_s[0] != parity.end_time_s[1]
    counts = {
        "other_outcome": np.sum(~parity.same),
        "beyond_the_bound": np.sum(~parity.within),
        "other_end": np.sum(other_end),
    }
    found = {
        f"{size}.{name}": Number(value=float(count), unit="robots", worse="count")
        for name, count in counts.items()
    }
    median = Number(value=float(np.median(greatest)), unit="m", worse="rounding")
    return {**found, f"{size}.median": median}


def to_markdown(parity: Parity) -> str:
    """The numbers as they stand on the page."""
    within, same = parity.within, parity.same
    greatest = parity.apart_m.max(axis=1)
    other_end = parity.end_time_s[0] != parity.end_time_s[1]
    rows = {
        "robots": f"{same.size:,}",
        "another outcome, or another thing touched": f"{np.sum(~same):,}",
        "episode ends at another control step": f"{np.sum(other_end):,}",
        f"positions within the bound ({parity.bound_m[-1]:.1e} m at the end)": f"{within.sum():,}",
        "greatest distance of a robot, median": f"{np.median(greatest):.1e} m",
        "greatest distance among those within": f"{greatest[within].max(initial=0.0):.1e} m",
        "greatest distance of all": f"{greatest.max():.1e} m",
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
) -> Parity:
    """Run the same worlds by mjx and by fused, and say how far they are apart.

    Args:
        scenario: name of a shipped scenario, or path of a file; the fleet is replaced.
        worlds: how many.
        seconds: length of the episodes.
        json: file for the result, as `angler validate` reads it.
    """
    tile = math.gcd(worlds, 125)
    chosen = everything(load_scenario(scenario, worlds=worlds, time={"horizon_s": seconds}))
    parity = compare(chosen, tile)
    names = [" ".join(kind) for kind in Simulator(chosen, tile=tile).variants()]
    print(report(parity, names))
    if json is not None:
        size = f"{worlds}_worlds_{seconds:g}_s"
        save_result(json, numbers(parity, size), to_markdown(parity))
    return parity


if __name__ == "__main__":
    tyro.cli(main)
