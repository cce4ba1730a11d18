"""Tables of a benchmark for a page: success by scene and team, and what successes took.

    python -m angler_experiments.benchmarks.table runs/reference

Shares are of all problems; those that a planner was not asked, as it had been given up on, count as
failed. What plans and flights took is the median of runs that succeeded.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from angler_mjx.runs.storage.intervals import wilson
from angler_mjx.studies.benchmark.report import reading
from angler_mjx.studies.benchmark.report.paired import compare
from angler_mjx.studies.benchmark.report.reading import Results, Runs

TOOK = (("planning_s", "planning, s"), ("makespan_s", "makespan, s"), ("energy_j", "energy, kJ"))


def success(results: Results) -> list[str]:
    """Success of each planner by scene (rows) and team (columns), in percent."""
    runs = results.runs
    teams = sorted(set(runs["robots"].tolist()))
    lines = []
    for scene in results.scenes:
        lines += ["", f"**{scene}**", ""]
        lines += _header(["success, %", *[str(team) for team in teams], "all teams (95 %)"])
        here = runs.where(runs["scene"] == scene)
        shares = {
            name: [_share(here, name, [team]) for team in teams] + [_share(here, name, teams)]
            for name in results.planners
        }
        best = [max(column, default=0.0) for column in zip(*shares.values(), strict=True)]
        for name, values in shares.items():
            cells = [
                _bold(f"{100 * x:.0f}", x == top and x > 0)
                for x, top in zip(values, best, strict=True)
            ]
            lines.append(
                f"| {name} | "
                + " | ".join([*cells[:-1], f"{cells[-1]} {_range(here, name)}"])
                + " |"
            )
    return lines


def took(results: Results, robots: int) -> list[str]:
    """What successful runs took, by scene and planner, for one size of team."""
    runs = results.runs
    lines = []
    for scene in results.scenes:
        lines += ["", f"**{scene}, {robots} robots**", ""]
        lines += _header(["median of successes", "runs", *[text for _, text in TOOK]])
        for name in results.planners:
            mine = (runs["planner"] == name) & (runs["scene"] == scene) & (runs["robots"] == robots)
            won = runs.where(mine & runs["success"])
            if len(won):
                scale = {"energy_j": 1e-3}
                cells = [f"{np.median(won[key]) * scale.get(key, 1.0):.3g}" for key, _ in TOOK]
                lines.append(f"| {name} | {len(won)} | " + " | ".join(cells) + " |")
    return lines


def truth(results: Results) -> list[str]:
    """Of teams whose plans were whole: how many arrived, by scene."""
    runs = results.runs
    lines = ["", *_header(["planned teams that all arrive", *results.scenes])]
    for name in results.planners:
        cells = []
        for scene in results.scenes:
            planned = (runs["planner"] == name) & (runs["scene"] == scene) & runs["planned"]
            count, won = int(planned.sum()), int((planned & runs["success"]).sum())
            cells.append(f"{won} of {count}" if count else "-")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def pairs(results: Results, names: Sequence[str]) -> list[str]:
    """Difference of success of the first planner and each of the others, on the same problems."""
    lines = ["", *_header([f"{names[0]} less", "problems", "points (95 %)", "McNemar's p"])]
    for name in names[1:]:
        one = compare(results, names[0], name)
        spread = f"{100 * one.difference:+.1f} ({100 * one.low:+.1f} to {100 * one.high:+.1f})"
        lines.append(f"| {name} | {one.pairs} | {spread} | {one.p:.2g} |")
    return lines


def _share(runs: Runs, planner: str, teams: Sequence[int]) -> float:
    mine = runs.counted & (runs["planner"] == planner) & np.isin(runs["robots"], teams)
    return float(runs["success"][mine].mean()) if mine.any() else 0.0


def _range(runs: Runs, planner: str) -> str:
    mine = runs.counted & (runs["planner"] == planner)
    low, high = wilson(int(runs["success"][mine].sum()), int(mine.sum()))
    return f"({100 * low:.0f} to {100 * high:.0f})"


def _bold(text: str, bold: bool) -> str:
    return f"**{text}**" if bold else text


def _header(cells: Sequence[str]) -> list[str]:
    return ["| " + " | ".join(cells) + " |", "|---" * len(cells) + "|"]


def main(folder: Annotated[Path, tyro.conf.Positional], robots: int = 4) -> None:
    """Print the tables of a results folder.

    Args:
        folder: Results folder of a benchmark.
        robots: Team of which the tables of what successes took are.
    """
    results = reading.read(folder)
    runs = results.runs
    won = {name: int(runs["success"][runs["planner"] == name].sum()) for name in results.planners}
    best_first = sorted(results.planners, key=lambda name: -won[name])
    tables = (success(results), truth(results), took(results, robots), pairs(results, best_first))
    for lines in tables:
        print("\n".join(lines))


if __name__ == "__main__":
    tyro.cli(main)
