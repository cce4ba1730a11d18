"""Examples to learn from: worlds as the network sees them, and an expert's ways through them.

Worlds that a simulator draws and plans never leave the device; folders of runs are read in
`sources`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.learned_planner import path_encoding
from angler_experiments.learned_planner import scene as seen
from angler_experiments.learned_planner.scene import Scene
from angler_mjx.errors import ConfigError
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario

BODIES = 12
"""Rows of obstacles in an example; of more than that the first are learned from."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Examples:
    """Worlds [W] and what the expert did in them."""

    scenes: Scene
    ways: jax.Array
    """[W, R, inner, 4]."""
    counts: jax.Array
    """bool [W, R] whether the expert found a way."""

    @property
    def count(self) -> int:
        """Worlds."""
        return int(self.ways.shape[0])


def scenario(
    *,
    preset: str = "reef",
    robots: int = 8,
    worlds: int = 256,
    planner: dict[str, Any] | None = None,
    still: bool = True,
    speed: float = 1.0,
    seed: int = 7,
) -> Scenario:
    """Teams of the reef fleet's two kinds.

    Args:
        preset: of the worlds.
        robots: in each.
        worlds: of the scenario, all in one tile.
        planner: its table.
        still: without current and obstacles; otherwise with those of `reef_fleet`, observed.
        speed: the current as a multiple of that of `reef_fleet`.
        seed: of the worlds.
    """
    sea = load_scenario("reef_fleet")
    small = robots // 2
    heavy = sea.fleet[0].model_copy(update={"count": robots - small})
    members: list[Any] = [heavy.model_dump(exclude_unset=True)]
    if small:
        members.append({"vehicle": "bluerov2", "count": small, "parameter_set": "blue_gazebo"})
    world: dict[str, Any] = {"preset": preset}
    if still:
        world |= {"currents": [], "obstacles": {"dynamic": {"count": 0}}}
    elif speed != 1.0:
        tide, eddies = (one.model_dump(exclude_unset=True) for one in sea.world.currents)
        tide["max_speed_mps"] *= speed
        eddies["peak_speed_mps"] = [speed * v for v in eddies["peak_speed_mps"]]
        world |= {"currents": [tide, eddies]}
    knows = {} if still else {"knows": {"obstacles": "observed"}}
    return load_scenario(
        "reef_fleet",
        worlds=worlds,
        tile=min(worlds, 4096),
        seed=seed,
        fleet=members,
        engine="fused",
        world=world,
        time={"horizon_s": 120.0, "record_hz": 0.0},
        planner={"name": "grid"} | knows | (planner or {}),
    )


def as_examples(problems: Problem, paths: Trajectory) -> Examples:
    """Examples of a batch; to be traced.

    Args:
        problems: [W] leading.
        paths: [W, R] of the expert.
    """

    def one(problem: Problem, path: Trajectory) -> Examples:
        frames = seen.lines(problem)
        way = jax.vmap(path_encoding.from_path)(path, frames, problem.team.cruise_speed_mps)
        return Examples(
            scenes=_packed(seen.scene(problem)),
            ways=jnp.where(path.found[:, None, None], way, 0.0),
            counts=path.found,
        )

    made: Examples = jax.vmap(one)(problems, paths)
    return made


def _packed(scene: Scene) -> Scene:
    """Of one type for all sources: as many rows of obstacles, and the large arrays in float16."""
    n = scene.body_exists.shape[0]
    more = max(BODIES - n, 0)
    return Scene(
        gap=scene.gap.astype(jnp.float16),
        own=scene.own,
        others=scene.others,
        bodies=jnp.pad(scene.bodies[:, :BODIES], ((0, 0), (0, more), (0, 0))),
        water=scene.water.astype(jnp.float16),
        exists=scene.exists,
        body_exists=jnp.pad(scene.body_exists[:BODIES], (0, more)),
    )


def of_team_of(examples: Examples, robots: int) -> Examples:
    """Examples with rows for ``robots``, those that are added not existing."""
    more = robots - examples.counts.shape[1]
    if more < 0:
        raise ConfigError(f"robots = {robots}: the examples have {examples.counts.shape[1]}")
    if more == 0:
        return examples
    s = examples.scenes

    def pad(leaf: jax.Array, *axes: int) -> jax.Array:
        return jnp.pad(leaf, [(0, more if k in axes else 0) for k in range(leaf.ndim)])

    return Examples(
        scenes=Scene(
            gap=pad(s.gap, 1),
            own=pad(s.own, 1),
            others=pad(s.others, 1, 2),
            bodies=pad(s.bodies, 1),
            water=pad(s.water, 1),
            exists=pad(s.exists, 1),
            body_exists=s.body_exists,
        ),
        ways=pad(examples.ways, 1),
        counts=pad(examples.counts, 1),
    )


def mirrored(batch: Examples, which: jax.Array) -> Examples:
    """Some worlds [W] of a batch seen in a mirror that stands along each robot's line."""

    def turn(leaf: jax.Array, flipped: jax.Array) -> jax.Array:
        return jnp.where(which.reshape((-1,) + (1,) * (leaf.ndim - 1)), flipped, leaf)

    def left(leaf: jax.Array, *columns: int) -> jax.Array:
        sign = np.ones(leaf.shape[-1], np.float32)
        sign[list(columns)] = -1.0
        return turn(leaf, leaf * sign.astype(leaf.dtype))

    s = batch.scenes
    return Examples(
        scenes=type(s)(
            gap=turn(s.gap, s.gap[..., ::-1, :]),
            own=s.own,
            others=left(s.others, 1, 4, 7),
            bodies=left(s.bodies, 1, 4),
            water=left(s.water, 1),
            exists=s.exists,
            body_exists=s.body_exists,
        ),
        ways=left(batch.ways, 1),
        counts=batch.counts,
    )


def joined(parts: Sequence[Examples]) -> Examples:
    """Parts as one, padded to the largest team."""
    robots = max(part.counts.shape[1] for part in parts)
    whole: Examples = jax.tree.map(
        lambda *leaves: jnp.concatenate(leaves), *(of_team_of(p, robots) for p in parts)
    )
    return whole


def drawn(simulator: Simulator, worlds: int, first: int = 0) -> Iterator[Examples]:
    """Examples of worlds that a simulator draws and its planner plans, a tile at a time.

    Args:
        simulator: with a planner on the device.
        worlds: how many, rounded up to tiles.
        first: index of the first.
    """
    make = jax.jit(as_examples)
    for index in range(first, first + worlds, simulator.tile):
        planned, problems = simulator.asked(index)
        yield make(problems, planned.path)
