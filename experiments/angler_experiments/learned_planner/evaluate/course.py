"""Worlds of a sea, sampled once, in which planners are flown one after the other."""

import time
from collections.abc import Callable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from functools import partial

import jax
import numpy as np

from angler_experiments.learned_planner.evaluate.lookahead import LookaheadSimulator
from angler_experiments.learned_planner.evaluate.rows import POINTS, Sea, build_scenario
from angler_experiments.learned_planner.planner import LearnedPlanner, LearnedSettings
from angler_mjx.files import JsonTable
from angler_mjx.planning.device_planner import build_device_planner
from angler_mjx.planning.planner import Path, PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.simulator.compilation import CompiledFunction, ParallelCompiler, PendingProgram
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.simulator.world_preparation import problem_settings
from angler_mjx.runs.storage.confidence_intervals import ClusteredRate, clustered_rates
from angler_mjx.sim.information import InformationLevel
from angler_mjx.sim.state import Outcome, World

_N_TIMED_CALLS = 2
"""Number of timed calls."""


@dataclass(frozen=True, kw_only=True)
class CourseRow:
    """Result of a planner in a sea."""

    found: ClusteredRate
    """Rate of robots that have a path."""
    arrived: ClusteredRate
    """Rate of robots that arrive."""
    planning_s: float
    """Seconds for all worlds, once compiled; the least of some calls."""
    compile_s: float
    flight_s: float
    detour: float | None
    """Length of the paths over that of the straight lines, mean over robots with a path."""
    planned_s: float | None
    """End time of paths, mean over robots with a path."""
    ended: Mapping[str, float]
    """Fraction of robots by outcome."""

    def table(self) -> dict[str, object]:
        """Return the row as a table for a file."""
        return asdict(self)


class EvaluationCourse:
    """Worlds of one tile."""

    def __init__(self, sea: Sea, worlds: int, report: Callable[[str], None]) -> None:
        """Compile the flight, and sample the worlds."""
        self.sea, self.worlds, self.report = sea, worlds, report
        grid_scenario = build_scenario(sea, {"name": "grid"}, worlds)
        self.simulator = Simulator(grid_scenario, tile=worlds, paths=PathShape(points=POINTS))
        compile_time = self.simulator.compile()
        self.sampled_worlds, self.problems = jax.block_until_ready(
            self.simulator.sample_problems(0)
        )
        report(
            f"{sea.label}: {worlds} worlds of {sea.robots} robots, {compile_time.total_s:.0f} s "
            "compiled"
        )

    def fly_all(self, planners: Mapping[str, JsonTable]) -> Iterator[tuple[str, CourseRow]]:
        """Yield rows of planners; all are compiled in parallel before any is timed.

        Args:
            planners: tables by names.

        Yields:
            Names and rows.
        """
        with ParallelCompiler(max(1, len(planners))) as compiler:
            pending = {
                name: self._begin_compile(compiler, table) for name, table in planners.items()
            }
        for name, program in pending.items():
            plan, compile_s = program.result()
            yield name, self._make_row(plan, compile_s)

    def _begin_compile(self, compiler: ParallelCompiler, planner: JsonTable) -> PendingProgram:
        planner_scenario = build_scenario(self.sea, planner, self.worlds)
        spec = planner_scenario.planner.planner_spec()
        information = planner_scenario.planner.information.to_information()
        device_planner = build_device_planner(spec, problem_settings(planner_scenario, information))
        return compiler.begin(CompiledFunction(device_planner.plan_batch), self.problems)

    def fly_ahead(
        self, settings: LearnedSettings, teams: int, current_level: InformationLevel
    ) -> CourseRow:
        """Return the row of the learned planner with several answers flown ahead.

        Args:
            settings: settings of the planner.
            teams: number of answers to each problem.
            current_level: information level of the current for the flight ahead, not for the
                planner; predicted would be flown as the truth.
        """
        grid_scenario = build_scenario(self.sea, {"name": "grid"}, self.worlds)
        information = replace(
            grid_scenario.planner.information.to_information(), current=current_level
        )
        _, flight_problems = self.simulator.sample_problems(0, information=information)
        planner = LearnedPlanner(replace(settings, points=POINTS))
        start_s = time.perf_counter()
        plan_function = CompiledFunction(partial(planner.plan_teams, teams=teams))
        program = plan_function.lower(self.problems).compile()
        compile_s = time.perf_counter() - start_s
        lookahead = LookaheadSimulator(grid_scenario)

        def plan(problems: Problem) -> Trajectory:
            return lookahead.select_best(self.sampled_worlds, program(problems), flight_problems)

        return self._make_row(plan, compile_s)

    def _make_row(self, plan: Callable[..., Path], compile_s: float) -> CourseRow:
        jax.block_until_ready(plan(self.problems))
        times = [time.perf_counter()]
        for _ in range(_N_TIMED_CALLS):
            path = jax.block_until_ready(plan(self.problems))
            times.append(time.perf_counter())
        planned_at_s = times[-1]
        outcome = self.fly_to_end(self.simulator.with_paths(self.sampled_worlds, path))
        flown_at_s = time.perf_counter()
        has_path = np.asarray(path.found)
        rates = [
            _clustered_rate(is_success) for is_success in (has_path, outcome == Outcome.REACHED)
        ]
        team = self.problems.team
        straight_m = np.linalg.norm(np.asarray(team.goal_m) - np.asarray(team.start_m), axis=-1)
        legs = np.diff(np.asarray(path.position_m), axis=-2)
        length_m = np.linalg.norm(legs, axis=-1).sum(axis=-1)
        return CourseRow(
            found=rates[0],
            arrived=rates[1],
            planning_s=float(np.diff(times).min()),
            compile_s=compile_s,
            flight_s=flown_at_s - planned_at_s,
            detour=_mean_or_none((length_m / straight_m)[has_path]),
            planned_s=_mean_or_none(np.asarray(path.time_s)[..., -1][has_path]),
            ended={kind.name.lower(): float((outcome == kind).mean()) for kind in Outcome},
        )

    def fly_to_end(self, worlds: World) -> np.ndarray:
        """Return outcomes [world, robot] of flights to their end."""
        state = self.simulator.reset(worlds)
        for _ in range(self.simulator.segments):
            state, _, running = self.simulator.advance(worlds, state)
            if not np.asarray(running).any():
                break
        return np.asarray(state.tally.outcome)


def _mean_or_none(values: np.ndarray) -> float | None:
    return float(values.mean()) if values.size else None


def _clustered_rate(is_success: np.ndarray) -> ClusteredRate:
    """Return a fraction [worlds, robots] with an interval clustered by worlds."""
    world = np.repeat(np.arange(is_success.shape[0]), is_success.shape[1])
    flat_success = is_success.reshape(-1)
    return clustered_rates({"yes": flat_success, "no": ~flat_success}, world)["yes"]
