"""Training examples: inputs of the network, and an expert's paths.

Worlds that a simulator samples and plans never leave the device; folders of runs are read in
`from_runs`.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.learned_planner import path_encoding
from angler_experiments.learned_planner import scene as seen
from angler_experiments.learned_planner.scene import Scene
from angler_mjx.errors import ConfigError
from angler_mjx.files import JsonTable
from angler_mjx.planning.problem import Problem
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario, load_scenario

MAX_BODIES = 12
"""Rows of obstacles in an example; further obstacles are left out."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Examples:
    """Worlds [W] and the expert's paths in them."""

    scenes: Scene
    encoded_paths: jax.Array
    """[W, R, inner, 4] encoded paths."""
    has_path: jax.Array
    """bool [W, R] whether the expert found a path."""

    @property
    def count(self) -> int:
        """Return the number of worlds."""
        return int(self.encoded_paths.shape[0])


def build_scenario(
    *,
    preset: str = "reef",
    robots: int = 8,
    worlds: int = 256,
    planner: JsonTable | None = None,
    still: bool = True,
    speed: float = 1.0,
    seed: int = 7,
) -> Scenario:
    """Build a scenario of teams of the reef fleet's two kinds.

    Args:
        preset: preset of the worlds.
        robots: number of robots in each world.
        worlds: worlds of the scenario, all in one tile.
        planner: table of the planner.
        still: without current and obstacles; otherwise with those of `reef_fleet`, observed.
        speed: the current as a multiple of that of `reef_fleet`.
        seed: seed of the worlds.
    """
    base = load_scenario("reef_fleet")
    small = robots // 2
    heavy = base.fleet[0].model_copy(update={"count": robots - small})
    members = [heavy.model_dump(exclude_unset=True)]
    if small:
        members.append({"vehicle": "bluerov2", "count": small, "parameter_set": "blue_gazebo"})
    world: dict[str, object] = {"preset": preset}
    if still:
        world |= {"currents": [], "obstacles": {"dynamic": {"count": 0}}}
    elif speed != 1.0:
        tide, eddies = (current.model_dump(exclude_unset=True) for current in base.world.currents)
        tide["max_speed_mps"] *= speed
        eddies["peak_speed_mps"] = [speed * v for v in eddies["peak_speed_mps"]]
        world |= {"currents": [tide, eddies]}
    information = {} if still else {"information": {"obstacles": "observed"}}
    return load_scenario(
        "reef_fleet",
        worlds=worlds,
        tile=min(worlds, 4096),
        seed=seed,
        fleet=members,
        engine="fused",
        world=world,
        time={"horizon_s": 120.0, "record_hz": 0.0},
        planner={"name": "grid"} | information | (planner or {}),
    )


def build_examples(problems: Problem, paths: Trajectory) -> Examples:
    """Build examples of a batch; to be traced.

    Args:
        problems: problems, [W] leading.
        paths: [W, R] paths of the expert.
    """

    def build_example(problem: Problem, path: Trajectory) -> Examples:
        frames = seen.build_frames(problem)
        encoded = jax.vmap(path_encoding.encode_path)(path, frames, problem.team.cruise_speed_mps)
        return Examples(
            scenes=_pack_scene(seen.build_scene(problem)),
            encoded_paths=jnp.where(path.found[:, None, None], encoded, 0.0),
            has_path=path.found,
        )

    examples: Examples = jax.vmap(build_example)(problems, paths)
    return examples


def _pack_scene(scene: Scene) -> Scene:
    """Convert to the type of all sources.

    As many rows of obstacles, and large arrays in float16.
    """
    n = scene.body_exists.shape[0]
    more = max(MAX_BODIES - n, 0)
    return Scene(
        gap=scene.gap.astype(jnp.float16),
        own=scene.own,
        others=scene.others,
        bodies=jnp.pad(scene.bodies[:, :MAX_BODIES], ((0, 0), (0, more), (0, 0))),
        water=scene.water.astype(jnp.float16),
        exists=scene.exists,
        body_exists=jnp.pad(scene.body_exists[:MAX_BODIES], (0, more)),
    )


def pad_team(examples: Examples, robots: int) -> Examples:
    """Pad examples to rows for ``robots``; added ones do not exist."""
    n_extra = robots - examples.has_path.shape[1]
    if n_extra < 0:
        raise ConfigError(f"robots = {robots}: the examples have {examples.has_path.shape[1]}")
    if n_extra == 0:
        return examples
    scenes = examples.scenes

    def pad(leaf: jax.Array, *axes: int) -> jax.Array:
        return jnp.pad(leaf, [(0, n_extra if k in axes else 0) for k in range(leaf.ndim)])

    return Examples(
        scenes=Scene(
            gap=pad(scenes.gap, 1),
            own=pad(scenes.own, 1),
            others=pad(scenes.others, 1, 2),
            bodies=pad(scenes.bodies, 1),
            water=pad(scenes.water, 1),
            exists=pad(scenes.exists, 1),
            body_exists=scenes.body_exists,
        ),
        encoded_paths=pad(examples.encoded_paths, 1),
        has_path=pad(examples.has_path, 1),
    )


def mirror_examples(batch: Examples, is_mirrored: jax.Array) -> Examples:
    """Mirror some worlds [W] of a batch in a plane along each robot's line."""

    def select(leaf: jax.Array, flipped: jax.Array) -> jax.Array:
        return jnp.where(is_mirrored.reshape((-1,) + (1,) * (leaf.ndim - 1)), flipped, leaf)

    def negate_columns(leaf: jax.Array, *columns: int) -> jax.Array:
        sign = np.ones(leaf.shape[-1], np.float32)
        sign[list(columns)] = -1.0
        return select(leaf, leaf * sign.astype(leaf.dtype))

    s = batch.scenes
    return Examples(
        scenes=type(s)(
            gap=select(s.gap, s.gap[..., ::-1, :]),
            own=s.own,
            others=negate_columns(s.others, 1, 4, 7),
            bodies=negate_columns(s.bodies, 1, 4),
            water=negate_columns(s.water, 1),
            exists=s.exists,
            body_exists=s.body_exists,
        ),
        encoded_paths=negate_columns(batch.encoded_paths, 1),
        has_path=batch.has_path,
    )


def join_examples(parts: Sequence[Examples]) -> Examples:
    """Join parts into one, padded to the largest team."""
    robots = max(part.has_path.shape[1] for part in parts)
    whole: Examples = jax.tree.map(
        lambda *leaves: jnp.concatenate(leaves), *(pad_team(p, robots) for p in parts)
    )
    return whole


def sample_examples(simulator: Simulator, worlds: int, first: int = 0) -> Iterator[Examples]:
    """Yield examples of worlds that a simulator samples and its planner plans, a tile at a time.

    Args:
        simulator: simulator with a planner on the device.
        worlds: number of worlds, rounded up to tiles.
        first: index of the first world.
    """
    build = jax.jit(build_examples)
    for index in range(first, first + worlds, simulator.tile):
        planned, problems = simulator.sample_problems(index)
        yield build(problems, planned.path)
