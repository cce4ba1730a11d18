"""What the learned planner is worth: whole flights in worlds that nobody learned from.

    python -m angler_experiments.learned_planner.evaluate arrivals --worlds 128
    python -m angler_experiments.learned_planner.evaluate curve --out runs/curve

Rows: ``straight`` flies the straight line; ``drawn`` the first way that the network draws, not
checked; ``learned`` is the planner as it comes; ``noise`` is the same repair of smooth noise
instead of the network's ways, so that what is learned can be told from what is repaired; ``grid``
and ``priority`` search.
"""

import time
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from angler_experiments.learned_planner import examples, sources, train
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.planning.planner import PathShape
from angler_mjx.planning.problem import Problem
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import Outcome
from angler_mjx.simulator.on_device import device_planner
from angler_mjx.simulator.simulator import Simulator
from angler_mjx.storage.intervals import Rate, clustered

SEED = 2_000_003
"""Of worlds to be judged in."""
POINTS = 32


@dataclass(frozen=True, kw_only=True)
class Sea:
    """Where planners are compared."""

    label: str
    preset: str = "reef"
    robots: int = 8
    still: bool = True
    speed: float = 1.0


SEAS = {
    sea.label: sea
    for sea in (
        Sea(label="reef"),
        Sea(label="dense", preset="dense"),
        Sea(label="reef, 16 robots", robots=16),
        Sea(label="reef, sea", still=False),
        Sea(label="reef, current x 1.5", still=False, speed=1.5),
    )
}


class Straight:
    """The straight line at cruise speed, whatever is in between."""

    def plan_batch(self, problems: Problem) -> Trajectory:
        """Paths [world, robot]."""
        team = problems.team
        far = jnp.sqrt(jnp.sum((team.goal_m - team.start_m) ** 2, axis=-1))
        end = far / (0.999 * team.cruise_speed_mps)
        row = jnp.arange(POINTS) > 0
        place = jnp.where(row[:, None], team.goal_m[..., None, :], team.start_m[..., None, :])
        return Trajectory(
            time_s=jnp.where(row, end[..., None], 0.0),
            position_m=place,
            found=jnp.ones(far.shape, bool),
        )


def planners(checkpoint: str = "", samples: int = 16) -> dict[str, dict[str, Any]]:
    """Tables ``planner`` of the rows."""
    straight = f"{__file__}:Straight"
    chosen = {"checkpoint": checkpoint, "samples": samples}

    def learned(**more: Any) -> dict[str, Any]:
        return {"name": "learned", "learned": chosen | more}

    return {
        "straight": {"name": straight},
        "drawn": learned(repair=False),
        "noise": learned(draw="noise"),
        "learned": learned(),
        "grid": {"name": "grid"},
        "priority": {"name": "priority"},
    }


def scenario(sea: Sea, planner: dict[str, Any], worlds: int) -> Scenario:
    """Of one row."""
    return examples.scenario(
        preset=sea.preset,
        robots=sea.robots,
        still=sea.still,
        speed=sea.speed,
        worlds=worlds,
        planner=planner | {"points": POINTS},
        seed=SEED,
    )


@dataclass(frozen=True, kw_only=True)
class Row:
    """What a planner comes to in a sea."""

    found: Rate
    """Robots that have a path."""
    arrived: Rate
    """Robots that arrive."""
    planning_s: float
    """Of all worlds, once compiled."""


class Course:
    """The worlds of a sea, drawn once, in which planners are flown one after the other."""

    def __init__(self, sea: Sea, worlds: int) -> None:
        """Draw the worlds; they are one tile."""
        self.sea, self.worlds = sea, worlds
        chosen = scenario(sea, {"name": "grid"}, worlds)
        self.simulator = Simulator(chosen, tile=worlds, paths=PathShape(points=POINTS))
        self.drawn, self.problems = self.simulator.asked(0)

    def fly(self, planner: dict[str, Any]) -> Row:
        """One planner's row.

        Args:
            planner: its table.
        """
        chosen = scenario(self.sea, planner, self.worlds)
        spec = chosen.planner.chosen()
        plan = jax.jit(device_planner(chosen, spec))
        path = jax.block_until_ready(plan(self.drawn, self.problems))
        begun = time.perf_counter()
        path = jax.block_until_ready(plan(self.drawn, self.problems))
        planning_s = time.perf_counter() - begun
        there = self.simulator.with_paths(self.drawn, path)
        state = self.simulator.reset(there)
        for _ in range(self.simulator.segments):
            state, _, running = self.simulator.advance(there, state)
            if not np.asarray(running).any():
                break
        ended = np.asarray(state.tally.outcome) == Outcome.REACHED
        found, arrived = (_rate(np.asarray(yes)) for yes in (path.found, ended))
        return Row(found=found, arrived=arrived, planning_s=planning_s)


def _rate(yes: np.ndarray) -> Rate:
    """Share [worlds, robots] with an interval that knows which robots share a world."""
    world = np.repeat(np.arange(yes.shape[0]), yes.shape[1])
    flat = yes.reshape(-1)
    return clustered({"yes": flat, "no": ~flat}, world)["yes"]


def arrivals(
    seas: tuple[str, ...] = tuple(SEAS),
    rows: tuple[str, ...] = ("straight", "drawn", "noise", "learned", "grid", "priority"),
    worlds: int = 128,
    checkpoint: str = "",
    samples: int = 16,
) -> None:
    """Print a row for each planner in each sea; all of a sea fly in the same worlds.

    Args:
        seas: by their labels.
        rows: planners.
        worlds: of each row.
        checkpoint: of the network; the shipped one if empty.
        samples: ways drawn for each robot.
    """
    tables = planners(checkpoint, samples)
    print("| sea | planner | have a path, % | arrive, % (95 %) | worlds/s |")
    print("|---|---|---|---|---|")
    for sea in seas:
        course = Course(SEAS[sea], worlds)
        for name in rows:
            row = course.fly(tables[name])
            print(
                f"| {sea} | {name} | {100 * row.found.rate:.1f} | {_shown(row.arrived)} | "
                f"{worlds / row.planning_s:.3g} |",
                flush=True,
            )


def _shown(rate: Rate) -> str:
    return f"{100 * rate.rate:.1f} ({100 * rate.low:.1f} to {100 * rate.high:.1f})"


def curve(
    out: Path,
    sizes: tuple[int, ...] = (1000, 10000, 100000),
    config: str = "small",
    steps: int | None = None,
    worlds: int = 128,
    rows: tuple[str, ...] = ("drawn", "learned"),
) -> None:
    """Train on more and more worlds, and print what each is worth in ``reef``.

    Args:
        out: folder of the trainings.
        sizes: worlds of the training sets; each is the beginning of the next.
        config: of `train`.
        steps: instead of the config's; the same for all sizes.
        worlds: that each is judged in.
        rows: planners.
    """
    chosen = train.CONFIGS[config]
    chosen = replace(chosen, steps=steps or chosen.steps)
    parts = sources.of_sources(chosen.sources, max(sizes))
    whole = sources.gathered(parts, max(sizes), partial(print, flush=True))
    course, lines = Course(SEAS["reef"], worlds), []
    for size in sizes:
        some = jax.tree.map(partial(_first, size), whole)
        train.train(chosen, some, out / str(size))
        tables = planners(str((out / str(size) / train.WEIGHTS).absolute()))
        for row in rows:
            lines.append(f"| {size} | {row} | {_shown(course.fly(tables[row]).arrived)} |")
            print(lines[-1], flush=True)
    print(
        "\n".join(["| worlds learned from | planner | arrive, % (95 %) |", "|---|---|---|", *lines])
    )


def _first(count: int, leaf: jax.Array) -> jax.Array:
    return leaf[:count]


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"arrivals": arrivals, "curve": curve})
