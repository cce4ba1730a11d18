"""Campaign of the referee: every shipped scenario on both engines, every robot judged.

    python -m angler_experiments.referee_campaign --robots 1000 --horizon-s 60

Runs are recorded at the control rate, which the referee needs to recompute everything. A row lists
the number of judged robots, the result, and the largest deviation of each quantity.
"""

import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import tyro

from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import Scenario, load_scenario, shipped_scenarios
from angler_mjx.testing import referee
from angler_mjx.testing.referee import RefereeVerdict

type Engine = Literal["mjx", "fused"]

DEVIATIONS = (
    "path_length_m",
    "energy_j",
    "min_clearance_m",
    "min_separation_m",
    "impact_speed_mps",
)
"""Quantities with a tolerance; the rest must be equal."""


@dataclass(frozen=True, kw_only=True)
class CampaignFlight:
    """Scenario, engine, and the referee's report of the run."""

    scenario: str
    engine: Engine
    verdict: RefereeVerdict


def prepare_scenario(name: str, engine: Engine, robots: int, horizon_s: float) -> Scenario:
    """Return a shipped scenario with about this number of robots, recorded at control rate."""
    scenario = load_scenario(name, engine=engine)
    worlds = max(1, round(robots / len(scenario.members())))
    timing = {"horizon_s": horizon_s, "record_hz": 1.0 / scenario.time.control_dt_s}
    return load_scenario(name, engine=engine, worlds=worlds, time=timing)


def fly_and_judge(
    names: tuple[str, ...], engines: tuple[Engine, ...], robots: int, horizon_s: float
) -> Iterator[CampaignFlight]:
    """Fly and judge, one run after another; runs are deleted from the disk."""
    for name in names:
        for engine in engines:
            with tempfile.TemporaryDirectory() as folder:
                run_folder = Path(folder) / "run"
                rollout(prepare_scenario(name, engine, robots, horizon_s), out=run_folder)
                yield CampaignFlight(
                    scenario=name, engine=engine, verdict=referee.judge(run_folder)
                )


def format_row(flight: CampaignFlight) -> str:
    """Format a row of the table."""
    verdict = flight.verdict
    wrong = sum(count.disagrees for count in verdict.counts.values())
    undecided = len(verdict.differences) - wrong
    largest = " | ".join(f"{verdict.counts[name].largest:.1e}" for name in DEVIATIONS)
    cells = f"{flight.scenario}, {flight.engine} | {verdict.worlds} | {verdict.robots}"
    return f"| {cells} | {wrong} | {undecided} | {largest} |"


def main(
    robots: int = 100,
    horizon_s: float = 30.0,
    scenarios: tuple[str, ...] = (),
    engines: tuple[Engine, ...] = ("mjx", "fused"),
) -> None:
    """Fly scenarios, judge every robot, print a row each.

    Args:
        robots: Approximate number of robots in each run.
        horizon_s: Horizon, instead of the scenarios' own.
        scenarios: Names of scenarios; all shipped ones if left out.
        engines: Engines to run.
    """
    print(f"| run | worlds | robots | disagree | undecided | {' | '.join(DEVIATIONS)} |")
    print(f"| --- | {' | '.join(['---:'] * (4 + len(DEVIATIONS)))} |")
    for flight in fly_and_judge(
        scenarios or tuple(shipped_scenarios()), engines, robots, horizon_s
    ):
        print(format_row(flight), flush=True)
        for difference in flight.verdict.differences:
            print(f"  {difference.line()}", flush=True)


if __name__ == "__main__":
    tyro.cli(main)
