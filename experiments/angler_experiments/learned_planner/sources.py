"""Where training takes its examples from: worlds drawn for it, or folders of runs."""

import math
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.learned_planner import examples as made_of
from angler_experiments.learned_planner.examples import Examples
from angler_mjx.control.trajectory import Trajectory
from angler_mjx.errors import ConfigError
from angler_mjx.planning.asking import team
from angler_mjx.planning.problem import Problem
from angler_mjx.sim import fleet, knowledge
from angler_mjx.simulator.simulator import Simulator
from angler_mjx.storage import environments
from angler_mjx.storage.folder import Run

EXPERT = "priority"
TRAINING_SEED = 1_000_003
"""Of worlds to learn from: no other seed has any of them."""


@dataclass(frozen=True, kw_only=True)
class Source:
    """Worlds of one kind."""

    worlds: int
    preset: str = "reef"
    robots: int = 8
    still: bool = True
    tile: int = 256


def of_sources(sources: Sequence[Source], worlds: int | None = None) -> Iterator[Examples]:
    """Examples drawn and planned on the device, a tile at a time.

    Args:
        sources: of them.
        worlds: in all, in the shares of the sources; theirs if left out.
    """
    total = sum(source.worlds for source in sources)
    share = 1.0 if worlds is None else worlds / total
    left = [_of_source(source, max(1, math.ceil(share * source.worlds))) for source in sources]
    # In turn, so that who stops early has some of all; and their programs compile side by side.
    with ThreadPoolExecutor(len(left)) as threads:
        while left:
            tiles = list(threads.map(_next, left))
            left = [part for part, tile in zip(left, tiles, strict=True) if tile is not None]
            yield from (tile for tile in tiles if tile is not None)


def _of_source(source: Source, count: int) -> Iterator[Examples]:
    scenario = made_of.scenario(
        preset=source.preset,
        robots=source.robots,
        still=source.still,
        worlds=min(source.tile, count),
        planner={"name": EXPERT},
        seed=TRAINING_SEED,
    )
    yield from made_of.drawn(Simulator(scenario), count)


def _next(part: Iterator[Examples]) -> Examples | None:
    return next(part, None)


def of_folders(folders: Iterable[Path]) -> Iterator[Examples]:
    """Examples of run folders, one after the other."""
    for folder in folders:
        yield from of_run(folder)


def gathered(
    parts: Iterable[Examples],
    worlds: int | None,
    tell: Callable[[str], None],
    seconds: float | None = None,
) -> Examples:
    """All examples on the device, in an order that mixes their sources.

    Args:
        parts: of them.
        worlds: the most that are taken; all if left out.
        tell: progress.
        seconds: after which no more parts are asked for.
    """
    kept: list[Examples] = []
    begun = time.perf_counter()
    for part in parts:
        kept.append(part)
        count = sum(one.count for one in kept)
        took = time.perf_counter() - begun
        if len(kept) % 4 == 0:
            tell(f"{count} worlds")
        if (worlds is not None and count >= worlds) or (seconds is not None and took > seconds):
            break
    whole = made_of.joined(kept)
    order = np.random.default_rng(0).permutation(whole.count)[:worlds]
    mixed: Examples = jax.tree.map(lambda leaf: leaf[order], whole)
    return mixed


def of_run(path: Path, tile: int = 64) -> Iterator[Examples]:
    """Examples of a run folder, from its files alone.

    Args:
        path: of the folder, with trajectories (``--record-hz 1`` is enough).
        tile: worlds at a time.

    Raises:
        ConfigError: the folder is damaged, stored no trajectories, or its plans are no lines.
    """
    run = Run(path)
    group, chosen = run.trajectories, run.scenario
    if "plan_yaw_rad" in group:
        raise ConfigError(f"{path}: its plans have headings; examples are taken of lines only")
    kinds = fleet.build(chosen.members(), multibody=False)
    variants = {
        (v.vehicle, v.parameter_set): i for i, v in enumerate(fleet.variants(chosen.members()))
    }
    labels = run.episodes.select(["vehicle", "parameter_set", "planned"]).to_pydict()
    robots = len(chosen.members())
    names = zip(labels["vehicle"], labels["parameter_set"], strict=True)
    of_row = np.array([_variant(variants, vehicle, chosen_set) for vehicle, chosen_set in names])
    planned = np.array(labels["planned"], bool).reshape(-1, robots)
    variant = of_row.reshape(-1, robots)
    places: Any = group["environment"]
    spec, knows = chosen.sim_spec(), chosen.planner.knows.knows()

    @jax.jit
    def make(environment: Any, variant: jax.Array, path: Trajectory) -> Examples:
        def ask(environment: Any, variant: jax.Array) -> Problem:
            control, _ = fleet.parameters(kinds, variant)
            speed = kinds.cruise_mps[jnp.arange(robots), variant]
            begun = team(
                control, environment.start_m, environment.start_yaw_rad, environment.goal_m
            )
            horizon = chosen.time.horizon_s
            water = spec.water
            return Problem(
                grid=environment.grid,
                floor_z_m=environment.floor_z_m,
                team=_with_speed(begun, speed),
                obstacles=knowledge.obstacles(
                    environment,
                    knows,
                    horizon,
                    spec.control_dt_s,
                    water.density_kgpm3,
                    water.gravity_mps2,
                ),
                current=knowledge.current(environment, knows.current),
                seed=jnp.uint32(0),
                horizon_s=horizon,
                goal_tolerance_m=spec.goal_tolerance_m,
                knows=knows,
                deadline_s=chosen.planner.deadline_s,
            )

        return made_of.as_examples(jax.vmap(ask)(environment, variant), path)

    plan_time, plan_m = (jnp.asarray(group[name]) for name in ("plan_time_s", "plan_m"))
    for low in range(0, len(variant), tile):
        part = slice(low, low + tile)
        environment = environments.read(places, part)
        plans = Trajectory(
            time_s=plan_time[part], position_m=plan_m[part], found=jnp.asarray(planned[part])
        )
        yield make(environment, variant[part], plans)


def _variant(variants: dict[tuple[str, str], int], vehicle: str, chosen: str) -> int:
    """Number of a variant; the vehicle is named by its file or as tables name it."""
    for (name, parameter_set), number in variants.items():
        if parameter_set == chosen and vehicle in (name, Path(name).stem):
            return number
    raise ConfigError(f"vehicle {vehicle}, {chosen}: is not in the scenario of the run")


def _with_speed(begun: Any, speed: jax.Array) -> Any:
    return type(begun)(**{**vars(begun), "cruise_speed_mps": speed})
