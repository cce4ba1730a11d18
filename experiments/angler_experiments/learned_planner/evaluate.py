"""What the learned planner is worth: whole flights in worlds that nobody learned from.

    python -m angler_experiments.learned_planner.evaluate arrivals --worlds 128
    python -m angler_experiments.learned_planner.evaluate curve --out runs/curve

Rows: ``straight`` flies the straight line; ``drawn`` the first way that the network draws, not
checked; ``learned`` is the planner as it comes; ``noise`` is the same repair of smooth noise
instead of the network's ways, so that what is learned can be told from what is repaired; ``grid``
and ``priority`` search.
"""

import tempfile
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
from angler_mjx.planning.problem import Problem
from angler_mjx.runs.rollout import rollout
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.state import Outcome
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


def flown(chosen: Scenario) -> tuple[Rate, Rate]:
    """Share of the robots that have a path, and of those that arrive, with 95 % intervals."""
    with tempfile.TemporaryDirectory() as folder:
        run = rollout(chosen, out=Path(folder) / "run")
        table = run.episodes
    world = np.asarray(table["world"])
    ended = np.asarray(table["outcome"])
    planned = np.asarray(table["planned"])
    rates = [
        clustered({"yes": yes, "no": ~yes}, world)["yes"]
        for yes in (planned.astype(bool), ended == Outcome.REACHED.name.lower())
    ]
    return rates[0], rates[1]


def planning(chosen: Scenario, tile: int = 64) -> float:
    """Worlds a second that are drawn and planned, after compiling."""
    simulator = Simulator(chosen, tile=tile)
    jax.block_until_ready(simulator.worlds())
    begun = time.perf_counter()
    jax.block_until_ready(simulator.worlds(tile))
    return tile / (time.perf_counter() - begun)


def arrivals(
    seas: tuple[str, ...] = tuple(SEAS),
    rows: tuple[str, ...] = ("straight", "drawn", "noise", "learned", "grid", "priority"),
    worlds: int = 128,
    checkpoint: str = "",
    samples: int = 16,
) -> None:
    """Print a row for each planner in each sea.

    Args:
        seas: by their labels.
        rows: planners.
        worlds: of each row.
        checkpoint: of the network; the shipped one if empty.
        samples: ways drawn for each robot.
    """
    tables = planners(checkpoint, samples)
    print("| sea | planner | have a path, % | arrive, % (95 %) |\n|---|---|---|---|")
    for sea in seas:
        for row in rows:
            found, arrived = flown(scenario(SEAS[sea], tables[row], worlds))
            print(
                f"| {sea} | {row} | {100 * found.rate:.1f} | {100 * arrived.rate:.1f} "
                f"({100 * arrived.low:.1f} to {100 * arrived.high:.1f}) |",
                flush=True,
            )


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
    lines = []
    for size in sizes:
        some = jax.tree.map(partial(_first, size), whole)
        train.train(chosen, some, out / str(size))
        tables = planners(str((out / str(size) / train.WEIGHTS).absolute()))
        for row in rows:
            _, arrived = flown(scenario(SEAS["reef"], tables[row], worlds))
            lines.append(
                f"| {size} | {row} | {100 * arrived.rate:.1f} "
                f"({100 * arrived.low:.1f} to {100 * arrived.high:.1f}) |"
            )
            print(lines[-1], flush=True)
    print(
        "\n".join(["| worlds learned from | planner | arrive, % (95 %) |", "|---|---|---|", *lines])
    )


def _first(count: int, leaf: jax.Array) -> jax.Array:
    return leaf[:count]


if __name__ == "__main__":
    tyro.extras.subcommand_cli_from_dict({"arrivals": arrivals, "curve": curve})
