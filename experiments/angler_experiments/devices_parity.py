r"""CPU against GPU: the same worlds on both, and the decisions that rounding changed.

    python -m angler_experiments.devices_parity --out devices.json

flies 256 worlds of `reef_fleet`, seed 7, in a process for each platform at the same time, and
traces every robot with another outcome (`angler_experiments.shared.tracing`). It needs a machine
with both. Two runs of one platform are compared by their tiles or by flags of XLA:

    python -m angler_experiments.devices_parity --platforms cpu cpu --tiles 128 64
    python -m angler_experiments.devices_parity --platforms cpu cpu \
        --second-flags=--xla_backend_extra_options=xla_cpu_disable_new_fusion_emitters
"""

import os
import subprocess
import sys
import tempfile
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import tyro

from angler_experiments.shared import flights, tracing
from angler_experiments.shared.flights import StudyFlight
from angler_experiments.shared.tracing import Trace
from angler_mjx.errors import RunError
from angler_mjx.scenario.scenario import Scenario, load_scenario
from angler_mjx.sim.state import Outcome
from angler_mjx.testing.validation.results import StudyNumber, save_result

DEVICES = {"gpu": "cuda", "cpu": "cpu"}
"""Names of platforms for JAX."""


@dataclass(frozen=True, kw_only=True)
class ParitySettings:
    """Settings of the flights, on both sides."""

    scenario: str = "reef_fleet"
    worlds: int = 256
    """Number of worlds."""
    seed: int = 7
    """Seed of the worlds."""
    seconds: float = 120.0
    """Length of the episodes."""

    def load(self) -> Scenario:
        """Return the scenario, sampled at control rate."""
        chosen = load_scenario(
            self.scenario, worlds=self.worlds, seed=self.seed, time={"horizon_s": self.seconds}
        )
        return flights.record_at_control_rate(chosen)


def fly_both(
    settings: ParitySettings,
    platforms: tuple[str, str],
    tiles: tuple[int, int],
    second_flags: str | None,
) -> tuple[StudyFlight, StudyFlight]:
    """Fly both sides, each in a process of its own, at the same time.

    Raises:
        RunError: a process failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"side_{k}.npz" for k in range(2)]
        processes = []
        for k, file in enumerate(files):
            environment = {**os.environ, "JAX_PLATFORMS": DEVICES[platforms[k]]}
            if k == 1 and second_flags is not None:
                environment["XLA_FLAGS"] = second_flags
            arguments = ["--side", str(file), "--tiles", str(tiles[k]), str(tiles[k])]
            for name in ParitySettings.__dataclass_fields__:
                arguments += [f"--{name}", str(getattr(settings, name))]
            command = [sys.executable, "-m", "angler_experiments.devices_parity", *arguments]
            processes.append(subprocess.Popen(command, env=environment))
        # Wait for both processes, so that neither remains.
        codes = [process.wait() for process in processes]
        for platform, code in zip(platforms, codes, strict=True):
            if code:
                raise RunError(f"the run on {platform} ended with {code}; its words stand above")
        first, second = (flights.load_flight(file) for file in files)
    return first, second


def path_length_differences(a: StudyFlight, b: StudyFlight) -> np.ndarray:
    """Return differences of path length of robots with the same outcome."""
    is_same_end = ~tracing.is_different(a, b)
    difference_m: np.ndarray = np.abs(a.path_length_m.astype(np.float64) - b.path_length_m)[
        is_same_end
    ]
    return difference_m


def result_numbers(a: StudyFlight, b: StudyFlight, traces: list[Trace]) -> dict[str, StudyNumber]:
    """Return the numbers that are compared between versions."""
    difference_m = path_length_differences(a, b)
    return {
        "other_end": StudyNumber(value=float(len(traces)), unit="robots", worse="count"),
        "path_median": StudyNumber(
            value=float(np.median(difference_m)), unit="m", worse="rounding"
        ),
    }


def to_markdown(a: StudyFlight, b: StudyFlight, traces: list[Trace], names: tuple[str, str]) -> str:
    """Format the results for the page."""
    difference_m = path_length_differences(a, b)
    arrived = [int(np.sum(side.outcome == Outcome.REACHED)) for side in (a, b)]
    n_other_outcome = sum(trace.outcomes[0] != trace.outcomes[1] for trace in traces)
    same_plans = bool(np.array_equal(a.planned, b.planned))
    percentage = f"{100 * len(traces) / a.outcome.size:.1f} %"
    lines = [
        f"{names[0]} and {names[1]}: of {a.outcome.size:,} robots {n_other_outcome} have another "
        "outcome, "
        f"{len(traces)} ({percentage}) another outcome or another thing touched; arrivals "
        f"{arrived[0]} "
        f"and {arrived[1]}; which plans are found is {'' if same_plans else 'not '}the same. "
        f"Path length where they end alike: median {np.median(difference_m):.1e} m, 99 % "
        f"{np.quantile(difference_m, 0.99):.1e} m, greatest {difference_m.max():.1e} m.",
    ]
    if not traces:
        return lines[0]
    counts = Counter(trace.cause.value for trace in traces)
    lines.append("What differed first: " + "; ".join(f"{k}: {n}" for k, n in counts.most_common()))
    rows = [
        "| world, robot | " + " | ".join(names) + " | first further apart than rounding explains "
        "| at, s | by, m | a second before, m |",
        "| --- | --- | --- | --- | ---: | ---: | ---: |",
    ]
    for t in traces:
        ends = [f"{name}, {s:.2f} s" for name, s in zip(t.outcomes, t.end_s, strict=True)]
        rows.append(
            f"| {t.world}, {t.robot} | {' | '.join(ends)} | {t.cause.value} | {t.at_s:.2f} "
            f"| {t.size_m:.1e} | {t.before_m:.1e} |"
        )
    return "\n\n".join([lines[0], lines[1] + ".", "\n".join(rows)])


def main(
    settings: tyro.conf.OmitArgPrefixes[ParitySettings] = ParitySettings(),
    platforms: tuple[str, str] = ("cpu", "gpu"),
    tiles: tuple[int, int] = (128, 128),
    second_flags: str | None = None,
    out: Path | None = None,
    side: Path | None = None,
) -> None:
    """Fly the same worlds on two platforms and trace every robot with another outcome.

    Args:
        settings: settings of the flights.
        platforms: cpu or gpu, twice.
        tiles: worlds in one call, of each.
        second_flags: flags of XLA for the second, instead of those of the environment.
        out: file for the result, as `angler validate` reads it.
        side: file for the flight of one side; it is flown here, on JAX's default platform.
    """
    scenario = settings.load()
    if side is not None:
        flights.save_flight(flights.fly_scenario(scenario, tiles[0]), side)
        return
    a, b = fly_both(settings, platforms, tiles, second_flags)
    physics_steps = scenario.sim_spec().physics_steps
    traces = tracing.trace_differences(a, b, scenario.time.control_dt_s, physics_steps)
    names = (f"{platforms[0]}, tile {tiles[0]}", f"{platforms[1]}, tile {tiles[1]}")
    text = to_markdown(a, b, traces, names)
    print(text)
    if out is not None:
        save_result(out, result_numbers(a, b, traces), text)


if __name__ == "__main__":
    tyro.cli(main)
