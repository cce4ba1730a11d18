"""The worlds of a sea, drawn once, in which planners are flown one after the other."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import Any

import jax
import numpy as np

from angler_experiments.learned_planner.evaluate.ahead import Ahead
from angler_experiments.learned_planner.evaluate.rows import POINTS, Sea, scenario
from angler_experiments.learned_planner.planner import LearnedPlanner, LearnedSettings
from angler_mjx.planning.planner import Path, PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.runs.simulator.compiling import Compiled, PendingProgram, Together
from angler_mjx.runs.simulator.on_device import device_planner
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.intervals import ClusteredRate, clustered
from angler_mjx.sim.information import InformationLevel
from angler_mjx.sim.state import Outcome, World

_TIMED = 2
"""Calls that are timed."""


@dataclass(frozen=True, kw_only=True)
class CourseRow:
    """What a planner comes to in a sea."""

    found: ClusteredRate
    """Robots that have a path."""
    arrived: ClusteredRate
    """Robots that arrive."""
    planning_s: float
    """Of all worlds, once compiled; the least of some calls."""
    compile_s: float
    flight_s: float
    detour: float | None
    """Length of the paths over that of the straight lines, in the mean of robots that have one."""
    planned_s: float | None
    """When paths end, in the mean of robots that have one."""
    ended: Mapping[str, float]
    """Share of robots by how they ended."""

    def table(self) -> dict[str, Any]:
        """For a file."""
        return asdict(self)


class EvaluationCourse:
    """Worlds that are one tile."""

    def __init__(self, sea: Sea, worlds: int, tell: Callable[[str], None]) -> None:
        """Compile what flies, and draw the worlds."""
        self.sea, self.worlds, self.tell = sea, worlds, tell
        chosen = scenario(sea, {"name": "grid"}, worlds)
        self.simulator = Simulator(chosen, tile=worlds, paths=PathShape(points=POINTS))
        took = self.simulator.compile()
        self.drawn, self.problems = jax.block_until_ready(self.simulator.asked(0))
        tell(f"{sea.label}: {worlds} worlds of {sea.robots} robots, {took.total_s:.0f} s compiled")

    def fly_all(self, planners: Mapping[str, dict[str, Any]]) -> Iterator[tuple[str, CourseRow]]:
        """Rows of planners as they come; all are compiled, side by side, before any is timed.

        Args:
            planners: tables by names.

        Yields:
            Names and rows.
        """
        with Together(max(1, len(planners))) as together:
            begun = {name: self._begin(together, table) for name, table in planners.items()}
        for name, program in begun.items():
            plan, compile_s = program.result()
            yield name, self._row(plan, compile_s)

    def _begin(self, together: Together, planner: dict[str, Any]) -> PendingProgram:
        chosen = scenario(self.sea, planner, self.worlds)
        plan = device_planner(chosen, chosen.planner.chosen())
        program = Compiled(plan)
        return together.begin(program, self.drawn, self.problems)

    def fly_ahead(self, settings: dict[str, Any], teams: int, told: InformationLevel) -> CourseRow:
        """The row of the learned planner where several of its answers are flown ahead.

        Args:
            settings: its own.
            teams: answers to each problem.
            told: how much of the current is known to the flight ahead, not to the planner;
                predicted would be flown as the truth.
        """
        chosen = scenario(self.sea, {"name": "grid"}, self.worlds)
        knows = replace(chosen.planner.knows.knows(), current=told)
        _, told_to_flight = self.simulator.asked(0, knows=knows)
        planner = LearnedPlanner(LearnedSettings(points=POINTS, **settings))
        begun = time.perf_counter()
        answer = Compiled(partial(planner.plan_teams, teams=teams))
        program = answer.lower(self.problems).compile()
        compile_s = time.perf_counter() - begun
        ahead = Ahead(chosen)

        def plan(worlds: World, problems: Problem) -> Trajectory:
            return ahead.best(worlds, program(problems), told_to_flight)

        return self._row(plan, compile_s)

    def _row(self, plan: Callable[..., Path], compile_s: float) -> CourseRow:
        jax.block_until_ready(plan(self.drawn, self.problems))
        times = [time.perf_counter()]
        for _ in range(_TIMED):
            path = jax.block_until_ready(plan(self.drawn, self.problems))
            times.append(time.perf_counter())
        planned = times[-1]
        outcome = self.flown(self.simulator.with_paths(self.drawn, path))
        flown = time.perf_counter()
        found = np.asarray(path.found)
        rates = [_rate(yes) for yes in (found, outcome == Outcome.REACHED)]
        team = self.problems.team
        straight = np.linalg.norm(np.asarray(team.goal_m) - np.asarray(team.start_m), axis=-1)
        legs = np.diff(np.asarray(path.position_m), axis=-2)
        length = np.linalg.norm(legs, axis=-1).sum(axis=-1)
        return CourseRow(
            found=rates[0],
            arrived=rates[1],
            planning_s=float(np.diff(times).min()),
            compile_s=compile_s,
            flight_s=flown - planned,
            detour=_mean((length / straight)[found]),
            planned_s=_mean(np.asarray(path.time_s)[..., -1][found]),
            ended={one.name.lower(): float((outcome == one).mean()) for one in Outcome},
        )

    def flown(self, worlds: World) -> np.ndarray:
        """Outcomes [world, robot] of flights to their end."""
        state = self.simulator.reset(worlds)
        for _ in range(self.simulator.segments):
            state, _, running = self.simulator.advance(worlds, state)
            if not np.asarray(running).any():
                break
        return np.asarray(state.tally.outcome)


def _mean(values: np.ndarray) -> float | None:
    return float(values.mean()) if values.size else None


def _rate(yes: np.ndarray) -> ClusteredRate:
    """Share [worlds, robots] with an interval that knows which robots share a world."""
    world = np.repeat(np.arange(yes.shape[0]), yes.shape[1])
    flat = yes.reshape(-1)
    return clustered({"yes": flat, "no": ~flat}, world)["yes"]
