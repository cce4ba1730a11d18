"""Tables and figures of the study of fleets: teams, planning anew in flight, and what is known.

    python -m angler_experiments.benchmarks.fleets runs/fleets --figures docs/images

Several folders are taken as one: the same study, shared among processes. Ways to fly are told apart
by planner or policy, and by how often plans are made anew; what they are told stands beside.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from angler_mjx.errors import ConfigError
from angler_mjx.studies.benchmark.report import reading
from angler_mjx.studies.benchmark.report.paired import compare
from angler_mjx.studies.benchmark.report.rates import ReportRate, rate
from angler_mjx.studies.benchmark.report.reading import Results, Runs

LEVELS = ("nothing", "observed", "predicted", "truth")
"""Of what may be known of obstacles that move, from least to most."""


@dataclass(frozen=True, kw_only=True)
class FleetsStudy:
    """The runs of the study."""

    results: Results
    ways: dict[str, str]
    """How the robots fly, by the planners' labels: a planner or a policy, and how often it plans
    anew."""
    left: int
    """Runs that are still to be flown; they are not among the results."""

    @property
    def every_way(self) -> list[str]:
        """In the order of the study."""
        return list(dict.fromkeys(self.ways[name] for name in self.results.planners))

    def of(self, way: str, preset: str, robots: int, level: str) -> Runs:
        """The runs of one cell that count."""
        runs = self.results.runs
        mine = np.isin(runs["planner"], [label for label, x in self.ways.items() if x == way])
        here = (runs["scene"] == preset) & (runs["robots"] == robots)
        told = runs["knows_obstacles"] == level
        return runs.where(runs.counted & mine & here & told)

    @property
    def known(self) -> Iterator[tuple[str, int]]:
        """Scenes and teams that were flown at more than one level."""
        runs = self.results.runs
        for scene in self.results.scenes:
            for robots in self.teams:
                here = (runs["scene"] == scene) & (runs["robots"] == robots)
                if len(set(runs["knows_obstacles"][here])) > 1:
                    yield scene, robots

    @property
    def teams(self) -> list[int]:
        """Numbers of robots."""
        return sorted(set(self.results.runs["robots"].tolist()))


def read(folders: Sequence[Path]) -> FleetsStudy:
    """Read results folders of one study; they need not be complete.

    Raises:
        ConfigError: one is none, or a run is in two of them.
    """
    parts = [reading.read(folder) for folder in folders]
    columns = {
        name: np.concatenate([part.runs[name] for part in parts]) for name in parts[0].runs.columns
    }
    every_run = Runs(columns)
    unflown = _to_be_flown(every_run)
    runs = every_run.where(~unflown)
    keys = ("planner", "scene", "robots", "knows_obstacles", "knows_current", "problem_seed")
    every = list(zip(*(columns[name].tolist() for name in (*keys, "world")), strict=True))
    if len(set(every)) < len(every):
        twice = next(key for i, key in enumerate(every) if key in every[:i])
        raise ConfigError(
            f"{', '.join(map(str, folders))}: planner {twice[0]!r}, {twice[1]}, {twice[2]} robots, "
            f"world {twice[-1]} is there twice; give each results folder once"
        )
    entries: list[Any] = [entry for part in parts for entry in part.about.get("planners", [])]
    ways = {entry["label"]: _way(entry) for entry in entries}
    scenes = list(dict.fromkeys(scene for part in parts for scene in part.scenes))
    about = {**parts[0].about, "planners": entries, "scenes": scenes}
    whole = replace(
        parts[0],
        about=about,
        runs=runs,
        problem=reading.problems(runs),
        world=reading.worlds(runs),
        examples=[],
    )
    return FleetsStudy(results=whole, ways=ways, left=int(unflown.sum()))


def _to_be_flown(runs: Runs) -> np.ndarray:
    ready = (runs["robots_planned"] > 0) | (runs["plan_status"] == reading.POLICY)
    unflown: np.ndarray = ready & ~runs["flown"] & runs.asked
    return unflown


def _way(entry: dict[str, Any]) -> str:
    online = entry.get("online", {})
    hz, order = online.get("replan_hz", 0.0), online.get("order", "free")
    return ", ".join(
        [entry["name"], *([f"{hz:g} Hz"] if hz else []), *(["in order"] if order == "kept" else [])]
    )


def arrivals(runs: Runs) -> ReportRate:
    """Teams that arrive whole."""
    return rate(runs["success"], np.ones(len(runs), bool))


def by_team(study: FleetsStudy, level: str) -> list[str]:
    """Whole teams that arrive, and of the robots, at one level: a table a scene."""
    lines = []
    for scene in study.results.scenes:
        lines += ["", f"**{scene}**", ""]
        teams = [str(team) for team in study.teams]
        lines += _header([f"teams (robots) that arrive, %; told `{level}`", *teams])
        for way in study.every_way:
            cells = [_cell(study.of(way, scene, team, level)) for team in study.teams]
            if any(cell != "-" for cell in cells):
                lines.append(f"| {way} | " + " | ".join(cells) + " |")
    return lines


def by_level(study: FleetsStudy) -> list[str]:
    """The same by what is known, where more than one level was flown."""
    lines = []
    for scene, robots in study.known:
        lines += ["", f"**{scene}, {_robots(robots)}**", ""]
        lines += _header(["teams (robots) that arrive, %", *[f"`{level}`" for level in LEVELS]])
        for way in study.every_way:
            cells = [_cell(study.of(way, scene, robots, level)) for level in LEVELS]
            if any(cell != "-" for cell in cells):
                lines.append(f"| {way} | " + " | ".join(cells) + " |")
    return lines


def replans(study: FleetsStudy) -> list[str]:
    """How often a robot on its way got no new plan, where plans are made anew."""
    head = ["no new plan, times a robot", "told", *[f"{team}" for team in study.teams]]
    lines = ["", *_header(head)]
    for scene in study.results.scenes:
        for way in study.every_way:
            for level in LEVELS:
                cells = [_failed(study.of(way, scene, team, level)) for team in study.teams]
                if any(cell != "-" for cell in cells):
                    row = " | ".join(cells)
                    lines.append(f"| {scene}, {way} | `{level}` | {row} |")
    return lines


def pairs(study: FleetsStudy) -> list[str]:
    """Each planner that plans anew, less the same one told as much that does not."""
    runs = study.results.runs
    lines = ["", *_header(["planned anew less once", "problems", "points (95 %)", "McNemar's p"])]
    told = {label: set(runs["knows_obstacles"][runs["planner"] == label]) for label in study.ways}
    for label, way in study.ways.items():
        for other, plain in study.ways.items():
            if way.startswith(f"{plain}, ") and told[label] & told[other]:
                one = compare(study.results, label, other)
                if one.pairs:
                    low, high = 100 * one.low, 100 * one.high
                    spread = f"{100 * one.difference:+.1f} ({low:+.1f} to {high:+.1f})"
                    lines.append(f"| {label} | {one.pairs} | {spread} | {one.p:.2g} |")
    return lines


def _cell(runs: Runs) -> str:
    if not len(runs):
        return "-"
    robots = runs["robots_reached"].sum() / runs["robots"].sum()
    return f"{100 * arrivals(runs).share:.0f} ({100 * robots:.0f})"


def _failed(runs: Runs) -> str:
    known = np.isfinite(runs["failed_replans"])
    if not known.any():
        return "-"
    return f"{runs['failed_replans'][known].sum() / runs['robots'][known].sum():.1f}"


def _robots(count: int) -> str:
    return f"{count} robot{'' if count == 1 else 's'}"


def _header(cells: Sequence[str]) -> list[str]:
    return ["| " + " | ".join(cells) + " |", "|---" * len(cells) + "|"]


def main(
    folders: Annotated[tuple[Path, ...], tyro.conf.Positional],
    level: str = "observed",
    figures: Path | None = None,
) -> None:
    """Print the tables of the study, and draw its figures.

    Args:
        folders: Results folders of the study.
        level: Of knowledge, of the tables by team.
        figures: Folder to draw figures into; none are drawn if left out.
    """
    if not folders:
        raise ConfigError("folders: give the results folder of the study, or several of its parts")
    if level not in LEVELS:
        raise ConfigError(f"--level {level}: give one of {', '.join(LEVELS)}")
    study = read(folders)
    if study.left:
        print(f"{study.left} runs are not flown yet, and left out")
    for lines in (by_team(study, level), by_level(study), replans(study), pairs(study)):
        print("\n".join(lines))
    if figures is not None:
        from angler_experiments.benchmarks import fleets_plotted

        for path in fleets_plotted.make(study, level, figures):
            print(path)


if __name__ == "__main__":
    try:
        tyro.cli(main)
    except ConfigError as error:
        raise SystemExit(str(error)) from None
