"""Speed of drawing environments on this device, apart from planning and simulation.

Timed is what `world.generate.generate_batch` gives, complete and on the device: cells, starts and
goals, path ratio and line of sight, obstacles and current. A batch with a world that cannot hold
its fleet, or whose ways are not finite, is refused.
"""

import time

import jax
import numpy as np

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.studies.speed.rows import SpeedRow
from angler_mjx.world.config import WorldConfig, resolve_world
from angler_mjx.world.environment import Environment
from angler_mjx.world.generate import generate_batch
from angler_mjx.world.rock.rules import AutomatonRule

_RADIUS_M = 0.4
"""About the bounding sphere of a BlueROV2."""


def measure(
    preset: str,
    *,
    robots: int,
    worlds: int,
    repeats: int,
    shape: tuple[int, int, int] | None = None,
) -> SpeedRow:
    """Time the drawing of worlds of a preset; every repeat draws other worlds.

    Args:
        preset: name of a shipped world.
        robots: in each world.
        worlds: in one device call.
        repeats: timed calls, after one that compiles and is timed apart.
        shape: cells along x, y, z; the preset's if left out. Random walls have the preset's share
            at any shape.

    Returns:
        Rates in worlds/s; ``compile_s`` is the whole first call.

    Raises:
        ConfigError: fewer than one repeat, or no such preset.
        RunError: some world cannot hold its fleet, or a way is not finite.
    """
    if repeats < 1:
        raise ConfigError(f"--repeats {repeats}: must be at least 1")
    config = WorldConfig(preset=preset)
    resolved = resolve_world(config)
    if shape is not None:
        fill = resolved.fill if isinstance(resolved.rule, AutomatonRule) else None
        config = WorldConfig(preset=preset, shape=shape, fill=fill)
    radius_m = np.full(robots, _RADIUS_M)

    def time_batch(i: int) -> float:
        start = time.perf_counter()
        environment = generate_batch(config, radius_m, 0, i * worlds, worlds)
        jax.block_until_ready(environment)
        seconds = time.perf_counter() - start
        _require_usable(environment, i * worlds)
        return seconds

    first_s = time_batch(0)
    rates = [worlds / time_batch(i) for i in range(1, repeats + 1)]
    nx, ny, nz = shape or resolved.shape
    return SpeedRow(
        workload=f"env_generation/{preset}/{nx}x{ny}x{nz}",
        inside="cells, starts and goals, shortest ways, lines of sight, obstacles, current",
        worlds=worlds,
        robots=robots,
        unit="worlds/s",
        median=float(np.median(rates)),
        low=min(rates),
        high=max(rates),
        repeats=repeats,
        compile_s=first_s,
    )


def _require_usable(environment: Environment, first: int) -> None:
    """Refuse a batch that a run could not use as a whole."""
    unfit = np.flatnonzero(~np.asarray(environment.valid))
    if unfit.size:
        raise RunError(
            f"world {first + unfit[0]} and {unfit.size - 1} more cannot hold the fleet: no number "
            "is given; take fewer robots or another preset"
        )
    if not np.isfinite(np.asarray(environment.path_ratio)).all():
        raise RunError("a shortest way in the timed worlds is not finite: no number is given")
