"""Tables and figures of the fleets benchmark: team sizes, replanning, information levels.

    python -m angler_experiments.benchmarks.fleets runs/fleets --figures docs/images

Several folders are taken as one study, divided among processes. Rows are planners or policies with
their replanning rate; columns are team sizes or information levels. The output is a page of
Markdown, such as docs/generated/benchmark_fleets.md.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from angler_mjx.errors import ConfigError
from angler_mjx.studies.benchmark.report import reading
from angler_mjx.studies.benchmark.report.paired import compare_planners
from angler_mjx.studies.benchmark.report.rates import ReportRate, compute_rate
from angler_mjx.studies.benchmark.report.reading import Results, Runs

LEVELS = ("nothing", "observed", "predicted", "truth")
"""Information levels of moving obstacles, from least to most."""


@dataclass(frozen=True, kw_only=True)
class FleetsStudy:
    """Runs of the study."""

    results: Results
    flight_modes: dict[str, str]
    """Flight mode by planner label: a planner or a policy, and its replanning period."""
    n_unflown: int
    """Number of runs that are not flown yet; they are not among the results."""

    @property
    def all_flight_modes(self) -> list[str]:
        """Return the flight modes in the order of the study."""
        return list(dict.fromkeys(self.flight_modes[name] for name in self.results.planners))

    def select_runs(self, flight_mode: str, preset: str, robots: int, level: str) -> Runs:
        """Return the counted runs of one cell."""
        runs = self.results.runs
        is_mode = np.isin(
            runs["planner"], [label for label, x in self.flight_modes.items() if x == flight_mode]
        )
        is_cell = (runs["scene"] == preset) & (runs["robots"] == robots)
        is_level = runs["knows_obstacles"] == level
        return runs.where(runs.counted & is_mode & is_cell & is_level)

    @property
    def multi_level_cases(self) -> Iterator[tuple[str, int]]:
        """Yield scenes and teams that were flown at several levels."""
        runs = self.results.runs
        for scene in self.results.scenes:
            for robots in self.teams:
                is_cell = (runs["scene"] == scene) & (runs["robots"] == robots)
                if len(set(runs["knows_obstacles"][is_cell])) > 1:
                    yield scene, robots

    @property
    def teams(self) -> list[int]:
        """Return the numbers of robots."""
        return sorted(set(self.results.runs["robots"].tolist()))


def read_study(folders: Sequence[Path]) -> FleetsStudy:
    """Read results folders of one study; they need not be complete.

    Raises:
        ConfigError: a folder holds no results, or a run is in two of them.
    """
    parts = [reading.read_results(folder) for folder in folders]
    columns = {
        name: np.concatenate([part.runs[name] for part in parts]) for name in parts[0].runs.columns
    }
    every_run = Runs(columns)
    unflown = _is_unflown(every_run)
    runs = every_run.where(~unflown)
    keys = ("planner", "scene", "robots", "knows_obstacles", "knows_current", "problem_seed")
    run_keys = list(zip(*(columns[name].tolist() for name in (*keys, "world")), strict=True))
    if len(set(run_keys)) < len(run_keys):
        repeated = next(key for i, key in enumerate(run_keys) if key in run_keys[:i])
        raise ConfigError(
            f"{', '.join(map(str, folders))}: planner {repeated[0]!r}, {repeated[1]}, "
            f"{repeated[2]} robots, "
            f"world {repeated[-1]} is there twice; give each results folder once"
        )
    entries: list[reading.AnnouncedPlanner] = [
        entry for part in parts for entry in part.about.get("planners", [])
    ]
    flight_modes = {entry["label"]: _flight_mode(entry) for entry in entries}
    scenes = list(dict.fromkeys(scene for part in parts for scene in part.scenes))
    about: reading.About = {**parts[0].about, "planners": entries, "scenes": scenes}
    all_results = replace(
        parts[0],
        about=about,
        runs=runs,
        problem=reading.index_problems(runs),
        world=reading.index_worlds(runs),
        examples=[],
    )
    return FleetsStudy(results=all_results, flight_modes=flight_modes, n_unflown=int(unflown.sum()))


def _is_unflown(runs: Runs) -> np.ndarray:
    ready = (runs["robots_planned"] > 0) | (runs["plan_status"] == reading.POLICY)
    unflown: np.ndarray = ready & ~runs["flown"] & runs.requested
    return unflown


def _flight_mode(entry: reading.AnnouncedPlanner) -> str:
    online = entry.get("online", {})
    hz, order = online.get("replan_hz", 0.0), online.get("order", "free")
    return ", ".join(
        [entry["name"], *([f"{hz:g} Hz"] if hz else []), *(["in order"] if order == "kept" else [])]
    )


def arrival_rate(runs: Runs) -> ReportRate:
    """Return the rate of teams that arrive whole."""
    return compute_rate(runs["success"], np.ones(len(runs), bool))


def format_by_team(study: FleetsStudy, level: str) -> list[str]:
    """Format arrivals of whole teams, and of robots, at one level: a table per scene."""
    lines = []
    for scene in study.results.scenes:
        lines += ["", f"**{scene}**", ""]
        teams = [str(team) for team in study.teams]
        lines += _format_header([f"teams (robots) that arrive, %; information `{level}`", *teams])
        for flight_mode in study.all_flight_modes:
            cells = [
                _format_cell(study.select_runs(flight_mode, scene, team, level))
                for team in study.teams
            ]
            if any(cell != "-" for cell in cells):
                lines.append(f"| {flight_mode} | " + " | ".join(cells) + " |")
    return lines


def format_by_level(study: FleetsStudy) -> list[str]:
    """Format the same by information level, where several levels were flown."""
    lines = []
    for scene, robots in study.multi_level_cases:
        lines += ["", f"**{scene}, {_format_robots(robots)}**", ""]
        lines += _format_header(
            ["teams (robots) that arrive, %", *[f"`{level}`" for level in LEVELS]]
        )
        for flight_mode in study.all_flight_modes:
            cells = [
                _format_cell(study.select_runs(flight_mode, scene, robots, level))
                for level in LEVELS
            ]
            if any(cell != "-" for cell in cells):
                lines.append(f"| {flight_mode} | " + " | ".join(cells) + " |")
    return lines


def format_replans(study: FleetsStudy) -> list[str]:
    """Format failed replans per robot, by scene, planner and information level."""
    header = ["failed replans per robot", "information", *[f"{team}" for team in study.teams]]
    lines = ["", *_format_header(header)]
    for scene in study.results.scenes:
        for flight_mode in study.all_flight_modes:
            for level in LEVELS:
                cells = [
                    _format_failed_replans(study.select_runs(flight_mode, scene, team, level))
                    for team in study.teams
                ]
                if any(cell != "-" for cell in cells):
                    row = " | ".join(cells)
                    lines.append(f"| {scene}, {flight_mode} | `{level}` | {row} |")
    return lines


def format_pairs(study: FleetsStudy) -> list[str]:
    """Format each replanning planner against itself without replanning, at the same level."""
    runs = study.results.runs
    lines = [
        "",
        *_format_header(["replanned less not", "problems", "points (95 %)", "McNemar's p"]),
    ]
    levels = {
        label: set(runs["knows_obstacles"][runs["planner"] == label])
        for label in study.flight_modes
    }
    for label, flight_mode in study.flight_modes.items():
        for other, base_mode in study.flight_modes.items():
            if flight_mode.startswith(f"{base_mode}, ") and levels[label] & levels[other]:
                comparison = compare_planners(study.results, label, other)
                if comparison.pairs:
                    low, high = 100 * comparison.low, 100 * comparison.high
                    spread = f"{100 * comparison.difference:+.1f} ({low:+.1f} to {high:+.1f})"
                    lines.append(
                        f"| {label} | {comparison.pairs} | {spread} | {comparison.p:.2g} |"
                    )
    return lines


def _format_cell(runs: Runs) -> str:
    if not len(runs):
        return "-"
    robots = runs["robots_reached"].sum() / runs["robots"].sum()
    return f"{100 * arrival_rate(runs).fraction:.0f} ({100 * robots:.0f})"


def _format_failed_replans(runs: Runs) -> str:
    is_finite = np.isfinite(runs["failed_replans"])
    if not is_finite.any():
        return "-"
    return f"{runs['failed_replans'][is_finite].sum() / runs['robots'][is_finite].sum():.1f}"


def _format_robots(count: int) -> str:
    return f"{count} robot{'' if count == 1 else 's'}"


def _format_header(cells: Sequence[str]) -> list[str]:
    return ["| " + " | ".join(cells) + " |", "|---" * len(cells) + "|"]


def main(
    folders: Annotated[tuple[Path, ...], tyro.conf.Positional],
    level: str = "observed",
    figures: Path | None = None,
) -> None:
    """Print the tables of the study, and plot its figures.

    Args:
        folders: Results folders of the study.
        level: Information level of the tables by team.
        figures: Folder of figures; none are plotted if left out.
    """
    if not folders:
        raise ConfigError("folders: give the results folder of the study, or several of its parts")
    if level not in LEVELS:
        raise ConfigError(f"--level {level}: give one of {', '.join(LEVELS)}")
    study = read_study(folders)
    print(
        "<!-- generated by python -m angler_experiments.benchmarks.fleets -->\n\n"
        "# Fleets: tables\n\n"
        "This page has the results of the benchmark `fleets`; "
        "[planners compared](../explanation/planner_comparison.md#fleets) interprets them."
    )
    if study.n_unflown:
        print(f"{study.n_unflown} runs are not flown yet, and left out")
    tables = {
        "By team": format_by_team(study, level),
        "By information level": format_by_level(study),
        "Failed replans": format_replans(study),
        "Paired": format_pairs(study),
    }
    for title, lines in tables.items():
        print("\n".join(["", f"## {title}", *lines]))
    if figures is not None:
        from angler_experiments.benchmarks import fleets_figures

        for path in fleets_figures.make_figures(study, level, figures):
            print(path)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except ConfigError as error:
        raise SystemExit(str(error)) from None
