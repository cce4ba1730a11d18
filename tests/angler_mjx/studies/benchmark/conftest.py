"""One small benchmark, interrupted twice and gone on with, for all tests of its results."""

import json

import pytest

from angler_mjx.planning.host.workers import Workers
from angler_mjx.progress import Progress
from angler_mjx.studies.benchmark import running

from ...sharing import alone, shared_folder

PLANNERS = '''
import numpy as np
from angler_mjx.planning.planner import NoPlan, way_points


class Straight:
    """Straight on at cruise speed, for as long as there is time."""

    def plan(self, problem):
        team = problem.team
        paths = []
        for start, goal, speed in zip(team.start_m, team.goal_m, team.cruise_speed_mps):
            time = np.linalg.norm(goal - start) / speed
            part = min(1.0, 0.999 * problem.horizon_s / time)
            paths.append(way_points([0, part * time], [start, start + part * (goal - start)]))
        return paths


class Moody(Straight):
    """As `Straight`, but for what its problem's number brings."""

    def plan(self, problem):
        paths = super().plan(problem)
        if problem.name.world == 1:
            raise ValueError("no idea")
        if problem.name.world == 2:
            paths[0] = NoPlan("not today")
        return paths


class Lazy:
    def plan(self, problem):
        return [NoPlan("too far") for _ in range(problem.robots)]
'''

FILE = """
name = "small"
scenario = "small.toml"
problems = 4
close_after = 3
deadline_s = 2.0

[[planner]]
name = "planners.py:Straight"

[[planner]]
name = "planners.py:Moody"

[[planner]]
name = "planners.py:Lazy"
label = "lazy <one>"
"""


class Interrupting(Progress):
    """Ends a benchmark after so many runs."""

    def __init__(self, after):
        self.left = after
        self.texts = []

    def start(self, total, done=0, unit="worlds"):
        self.total = total

    def describe(self, text):
        self.texts.append(text)
        if self.left == "before the tables" and text.startswith("tables"):
            raise KeyboardInterrupt

    def advance(self, runs, vehicle_steps=0):
        if isinstance(self.left, int):
            self.left -= runs
            if self.left <= 0:
                raise KeyboardInterrupt


def workers():
    return Workers(None, 2)


@pytest.fixture(scope="session")
def source(tmp_path_factory, scenario_file):
    folder = shared_folder(tmp_path_factory, "benchmark")
    file = folder / "benchmark.toml"
    with alone(folder):
        if not file.exists():
            (folder / "small.toml").write_text(scenario_file.read_text())
            (folder / "planners.py").write_text(PLANNERS)
            file.write_text(FILE)
    return file


@pytest.fixture(scope="session")
def made(source):
    """A results folder, and what its database held when it was interrupted first."""
    with alone(source.parent):
        notes = source.parent / "kept.json"
        if not notes.exists():
            notes.write_text(json.dumps(_interrupted(source)))
    return source.parent / "results", [tuple(row) for row in json.loads(notes.read_text())]


def _interrupted(source):
    """Make the results; what its database held when it was interrupted first."""
    benchmark, out = running.read_benchmark(source), source.parent / "results"
    with pytest.raises(KeyboardInterrupt):
        running.run_benchmark(benchmark, source, out, workers=workers, progress=Interrupting(5))
    early = out.parent / ".results.partial" / "results.sqlite"
    kept = rows(early, "SELECT id, plannerid, world, time FROM runs")
    again = Interrupting("before the tables")
    with pytest.raises(KeyboardInterrupt):
        running.run_benchmark(benchmark, source, out, workers=workers, resume=True, progress=again)
    last = Interrupting(None)
    running.run_benchmark(
        running.read_benchmark(source), source, out, workers=workers, resume=True, progress=last
    )
    return kept


def rows(path, query):
    import sqlite3

    base = sqlite3.connect(path)
    try:
        return base.execute(query).fetchall()
    finally:
        base.close()
