"""Referee: every robot's episode recomputed from the record of a run and compared with it.

It uses NumPy alone, in float64, with its own distances, and its own reader of vehicle and thruster
files, and nothing of the simulator (an import contract enforces it). docs/how_to/verify.md lists
the judged quantities, their definitions, and the limits.
"""

from collections.abc import Callable, Sequence
from pathlib import Path

from angler_mjx.errors import ConfigError
from angler_mjx.testing.referee import bounding, judging
from angler_mjx.testing.referee.findings import (
    CARRY_QUANTITIES,
    CONTACT_QUANTITIES,
    QUANTITIES,
    TASK_QUANTITIES,
    FindingCount,
    RefereeFinding,
    RefereeVerdict,
)
from angler_mjx.testing.referee.record import RefereeRun, open_run, read_worlds
from angler_mjx.testing.referee.scene import RefereeScene

__all__ = [
    "CARRY_QUANTITIES",
    "CONTACT_QUANTITIES",
    "QUANTITIES",
    "TASK_QUANTITIES",
    "FindingCount",
    "RefereeFinding",
    "RefereeVerdict",
    "judge",
]


def judge(
    path: Path | str,
    chosen: Sequence[int] | None = None,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> RefereeVerdict:
    """Judge worlds of a run folder.

    Args:
        path: the run folder.
        chosen: indices of worlds; all finished worlds if left out.
        progress: called with the number of worlds done and the total.

    Raises:
        ConfigError: it is no run folder, stored no trajectories, is damaged, or lacks a world.
    """
    run = open_run(Path(path))
    selected = sorted(run.rows) if chosen is None else sorted(set(chosen))
    missing = [world for world in selected if world not in run.rows]
    if missing or not selected:
        available = (
            f"worlds {min(run.rows)} to {max(run.rows)}" if run.rows else "no finished world"
        )
        raise ConfigError(f"--worlds {', '.join(map(str, missing))}: {path} holds {available}")
    verdict = RefereeVerdict(
        run=str(path),
        planned_worlds=run.planned_worlds,
        finished_worlds=len(run.rows),
        sampled=_describe_sampling(run),
    )
    progress(0, len(selected))
    for world in read_worlds(run, selected):
        scene = RefereeScene(run=run, world=world, rows=run.rows[world.index])
        for robot in range(len(run.robots)):
            verdict.add(_judge_robot(scene, robot))
        verdict.worlds += 1
        verdict.robots += len(run.robots)
        verdict.passed_goal_early += sum(bool(row["passed_goal_early"]) for row in scene.rows)
        progress(verdict.worlds, len(selected))
    return verdict


def _judge_robot(scene: RefereeScene, robot: int) -> list[RefereeFinding]:
    """Recompute an episode where every step until the end was stored; else compare with bounds."""
    stored = scene.state_at(scene.stored_step[robot])
    has_all_commands = len(scene.world.step) > len(scene.world.pwm_us)
    if scene.run.every == 1 and (has_all_commands or stored is not None):
        return judging.judge_exact(scene, robot, stored or 0)
    return bounding.judge_bounded(scene, robot)


def _describe_sampling(run: RefereeRun) -> str:
    older = ""
    if run.has_older_rows:
        older = "; of an older version, in which a robot arrived whenever it was near its goal"
    if run.every > 1:
        return (
            f"every {run.every} control steps: most quantities can only be bounded; record at "
            f"{1.0 / run.control_dt_s:g} Hz to have them worked out anew{older}"
        )
    ends = "" if "end" in run.group else ", but not the state after the last step"
    return f"every control step{ends}{older}"
