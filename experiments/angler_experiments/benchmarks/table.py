"""Tables of a benchmark for documents: success by scene and team, and costs of successes.

    python -m angler_experiments.benchmarks.table runs/reference

Fractions are of all problems; those that a planner did not receive after it was given up count as
failed. Costs of plans and flights are medians of runs that succeeded.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from angler_mjx.runs.storage.confidence_intervals import wilson_interval
from angler_mjx.studies.benchmark.report import reading
from angler_mjx.studies.benchmark.report.paired import compare_planners
from angler_mjx.studies.benchmark.report.reading import Results, Runs

COST_COLUMNS = (
    ("planning_s", "planning, s"),
    ("makespan_s", "makespan, s"),
    ("energy_j", "energy, kJ"),
)


def format_success(results: Results) -> list[str]:
    """Format the success of each planner by scene (rows) and team (columns), in percent."""
    runs = results.runs
    teams = sorted(set(runs["robots"].tolist()))
    lines = []
    for scene in results.scenes:
        lines += ["", f"**{scene}**", ""]
        lines += _format_header(["success, %", *[str(team) for team in teams], "all teams (95 %)"])
        scene_runs = runs.where(runs["scene"] == scene)
        fractions = {
            name: [_success_fraction(scene_runs, name, [team]) for team in teams]
            + [_success_fraction(scene_runs, name, teams)]
            for name in results.planners
        }
        best = [max(column, default=0.0) for column in zip(*fractions.values(), strict=True)]
        for name, values in fractions.items():
            cells = [
                _format_bold(f"{100 * x:.0f}", x == top and x > 0)
                for x, top in zip(values, best, strict=True)
            ]
            lines.append(
                f"| {name} | "
                + " | ".join([*cells[:-1], f"{cells[-1]} {_format_interval(scene_runs, name)}"])
                + " |"
            )
    return lines


def format_costs(results: Results, robots: int) -> list[str]:
    """Format costs of successful runs, by scene and planner, for one size of team."""
    runs = results.runs
    lines = []
    for scene in results.scenes:
        lines += ["", f"**{scene}, {robots} robots**", ""]
        lines += _format_header(
            ["median of successes", "runs", *[text for _, text in COST_COLUMNS]]
        )
        for name in results.planners:
            is_selected = (
                (runs["planner"] == name) & (runs["scene"] == scene) & (runs["robots"] == robots)
            )
            successes = runs.where(is_selected & runs["success"])
            if len(successes):
                scale = {"energy_j": 1e-3}
                cells = [
                    f"{np.median(successes[key]) * scale.get(key, 1.0):.3g}"
                    for key, _ in COST_COLUMNS
                ]
                lines.append(f"| {name} | {len(successes)} | " + " | ".join(cells) + " |")
    return lines


def format_arrivals(results: Results) -> list[str]:
    """Format arrivals of teams with complete plans, by scene."""
    runs = results.runs
    lines = ["", *_format_header(["planned teams that all arrive", *results.scenes])]
    for name in results.planners:
        cells = []
        for scene in results.scenes:
            planned = (runs["planner"] == name) & (runs["scene"] == scene) & runs["planned"]
            count, n_success = int(planned.sum()), int((planned & runs["success"]).sum())
            cells.append(f"{n_success} of {count}" if count else "-")
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return lines


def format_pairs(results: Results, names: Sequence[str]) -> list[str]:
    """Format the difference of success of first planner and each other, on the same problems."""
    lines = ["", *_format_header([f"{names[0]} less", "problems", "points (95 %)", "McNemar's p"])]
    for name in names[1:]:
        comparison = compare_planners(results, names[0], name)
        difference, low, high = (
            f"{100 * x:+.1f}" for x in (comparison.difference, comparison.low, comparison.high)
        )
        spread = f"{difference} ({low} to {high})"
        lines.append(f"| {name} | {comparison.pairs} | {spread} | {comparison.p:.2g} |")
    return lines


def _success_fraction(runs: Runs, planner: str, teams: Sequence[int]) -> float:
    is_selected = runs.counted & (runs["planner"] == planner) & np.isin(runs["robots"], teams)
    return float(runs["success"][is_selected].mean()) if is_selected.any() else 0.0


def _format_interval(runs: Runs, planner: str) -> str:
    is_selected = runs.counted & (runs["planner"] == planner)
    low, high = wilson_interval(int(runs["success"][is_selected].sum()), int(is_selected.sum()))
    return f"({100 * low:.0f} to {100 * high:.0f})"


def _format_bold(text: str, bold: bool) -> str:
    return f"**{text}**" if bold else text


def _format_header(cells: Sequence[str]) -> list[str]:
    return ["| " + " | ".join(cells) + " |", "|---" * len(cells) + "|"]


def main(folder: Annotated[Path, tyro.conf.Positional], robots: int = 4) -> None:
    """Print the tables of a results folder.

    Args:
        folder: Results folder of a benchmark.
        robots: Team of the tables of costs.
    """
    results = reading.read_results(folder)
    runs = results.runs
    n_successes = {
        name: int(runs["success"][runs["planner"] == name].sum()) for name in results.planners
    }
    best_first = sorted(results.planners, key=lambda name: -n_successes[name])
    tables = {
        "Success": format_success(results),
        "Flight of the plans": format_arrivals(results),
        "Cost of successes": format_costs(results, robots),
        "Paired": format_pairs(results, best_first),
    }
    print(
        "<!-- generated by python -m angler_experiments.benchmarks.table -->\n\n"
        "# Planners: tables\n\n"
        "This page has the results of the benchmark `reference`; "
        "[planners compared](../explanation/planner_comparison.md#reference) interprets them. "
        "Bold: best of a column."
    )
    for title, lines in tables.items():
        print("\n".join(["", f"## {title}", *lines]))


if __name__ == "__main__":
    tyro.cli(main)
