"""Every shipped scenario flown by both engines, every robot judged by the referee.

    python -m angler_experiments.referee_campaign --robots 1000 --horizon-s 60

Runs are recorded at the control rate, which the referee needs to work everything out anew. A row
says how many robots were judged, what came of it, and the largest deviation of each quantity.
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
"""What has a tolerance; the rest is to be equal."""


@dataclass(frozen=True, kw_only=True)
class CampaignFlight:
    """A scenario, an engine, and what the referee says of their run."""

    scenario: str
    engine: Engine
    verdict: RefereeVerdict


def prepare_scenario(name: str, engine: Engine, robots: int, horizon_s: float) -> Scenario:
    """A shipped scenario with about so many robots in all, recorded at the control rate."""
    scenario = load_scenario(name, engine=engine)
    worlds = max(1, round(robots / len(scenario.members())))
    timing = {"horizon_s": horizon_s, "record_hz": 1.0 / scenario.time.control_dt_s}
    return load_scenario(name, engine=engine, worlds=worlds, time=timing)


def fly_and_judge(
    names: tuple[str, ...], engines: tuple[Engine, ...], robots: int, horizon_s: float
) -> Iterator[CampaignFlight]:
    """Fly and judge, one run after another; no run stays on the disk."""
    for name in names:
        for engine in engines:
            with tempfile.TemporaryDirectory() as folder:
                run_folder = Path(folder) / "run"
                rollout(prepare_scenario(name, engine, robots, horizon_s), out=run_folder)
                yield CampaignFlight(
                    scenario=name, engine=engine, verdict=referee.judge(run_folder)
                )


def format_row(flight: CampaignFlight) -> str:
    """A row of the table."""
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
        robots: About so many in each run.
        horizon_s: Instead of the scenarios' own.
        scenarios: Names; all that are shipped if left out.
        engines: Which of the two.
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
