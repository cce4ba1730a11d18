r"""CPU against GPU: the same worlds on both, and which decision made rounding a difference.

    python -m angler_experiments.devices_parity --out devices.json

flies 256 worlds of `reef_fleet`, seed 7, in a process for each platform at the same time, and
traces every robot that ended otherwise (`angler_experiments.shared.tracing`). It needs a machine
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
from angler_mjx.testing.validation.results import Number, save_result

DEVICES = {"gpu": "cuda", "cpu": "cpu"}
"""What JAX is told."""


@dataclass(frozen=True, kw_only=True)
class ParitySettings:
    """What is flown, on both sides."""

    scenario: str = "reef_fleet"
    worlds: int = 256
    """How many."""
    seed: int = 7
    """Of the worlds."""
    seconds: float = 120.0
    """Length of the episodes."""

    def load(self) -> Scenario:
        """The scenario, sampled at control rate."""
        chosen = load_scenario(
            self.scenario, worlds=self.worlds, seed=self.seed, time={"horizon_s": self.seconds}
        )
        return flights.at_control_rate(chosen)


def compare(
    settings: ParitySettings,
    platforms: tuple[str, str],
    tiles: tuple[int, int],
    second_flags: str | None,
) -> tuple[StudyFlight, StudyFlight]:
    """Fly both sides, each in a process of its own, at the same time.

    Raises:
        RunError: one of them failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        files = [Path(folder) / f"side_{k}.npz" for k in range(2)]
        running = []
        for k, file in enumerate(files):
            environment = {**os.environ, "JAX_PLATFORMS": DEVICES[platforms[k]]}
            if k == 1 and second_flags is not None:
                environment["XLA_FLAGS"] = second_flags
            words = ["--side", str(file), "--tiles", str(tiles[k]), str(tiles[k])]
            for name in ParitySettings.__dataclass_fields__:
                words += [f"--{name}", str(getattr(settings, name))]
            command = [sys.executable, "-m", "angler_experiments.devices_parity", *words]
            running.append(subprocess.Popen(command, env=environment))
        # Both are waited for, so that none is left behind.
        codes = [process.wait() for process in running]
        for platform, code in zip(platforms, codes, strict=True):
            if code:
                raise RunError(f"the run on {platform} ended with {code}; its words stand above")
        first, second = (flights.load(file) for file in files)
    return first, second


def ways(a: StudyFlight, b: StudyFlight) -> np.ndarray:
    """Differences of path length of robots that ended the same way."""
    same = ~tracing.different(a, b)
    apart: np.ndarray = np.abs(a.path_length_m.astype(np.float64) - b.path_length_m)[same]
    return apart


def numbers(a: StudyFlight, b: StudyFlight, traces: list[Trace]) -> dict[str, Number]:
    """What is compared from one time to the next."""
    apart = ways(a, b)
    return {
        "other_end": Number(value=float(len(traces)), unit="robots", worse="count"),
        "path_median": Number(value=float(np.median(apart)), unit="m", worse="rounding"),
    }


def to_markdown(a: StudyFlight, b: StudyFlight, traces: list[Trace], names: tuple[str, str]) -> str:
    """What was found, as it stands on the page."""
    apart = ways(a, b)
    arrived = [int(np.sum(side.outcome == Outcome.REACHED)) for side in (a, b)]
    other = sum(trace.outcomes[0] != trace.outcomes[1] for trace in traces)
    same_plans = bool(np.array_equal(a.planned, b.planned))
    share = f"{100 * len(traces) / a.outcome.size:.1f} %"
    lines = [
        f"{names[0]} and {names[1]}: of {a.outcome.size:,} robots {other} have another outcome, "
        f"{len(traces)} ({share}) another outcome or another thing touched; arrivals {arrived[0]} "
        f"and {arrived[1]}; which plans are found is {'' if same_plans else 'not '}the same. "
        f"Path length where they end alike: median {np.median(apart):.1e} m, 99 % "
        f"{np.quantile(apart, 0.99):.1e} m, greatest {apart.max():.1e} m.",
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
    """Fly the same worlds on two platforms and trace every robot that ended otherwise.

    Args:
        settings: what is flown.
        platforms: cpu or gpu, twice.
        tiles: worlds in one call, of each.
        second_flags: flags of XLA for the second, instead of those of the environment.
        out: file for the result, as `angler validate` reads it.
        side: file for the flight of one side; it is flown here, on JAX's default platform.
    """
    scenario = settings.load()
    if side is not None:
        flights.save(flights.fly(scenario, tiles[0]), side)
        return
    a, b = compare(settings, platforms, tiles, second_flags)
    physics_steps = scenario.sim_spec().physics_steps
    traces = tracing.trace(a, b, scenario.time.control_dt_s, physics_steps)
    names = (f"{platforms[0]}, tile {tiles[0]}", f"{platforms[1]}, tile {tiles[1]}")
    text = to_markdown(a, b, traces, names)
    print(text)
    if out is not None:
        save_result(out, numbers(a, b, traces), text)


if __name__ == "__main__":
    tyro.cli(main)
