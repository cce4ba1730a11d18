"""Problems on disk, for planners that are no part of this package: a Zarr group, worlds leading.

Names of the arrays are those of the fields of `angler_mjx.planning.problem.Problem`, with "/"
between levels (``grid/occupied``, ``team/start_m``). The attributes hold what a file of plans has
to repeat: ``digest`` and ``seed``.
"""

from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import jax
import numpy as np
import zarr
from zarr.codecs import BloscCodec

from angler_mjx.planning.problem import Problem
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage import array_metadata, results_folder
from angler_mjx.runs.storage.environments import named_leaves

SCHEMA, SCHEMA_VERSION = "angler_mjx problems", 2
"""Version 2: what was ``obstacles/size_m`` is ``obstacles/half_size_m``, of the same meaning."""


def write_problems(
    path: Path,
    simulator: Simulator,
    advance: Callable[[int], None] = lambda done: None,
    *,
    raw: bool = False,
    extend: Callable[[zarr.Group, list[Problem]], None] | None = None,
) -> None:
    """Write the problems of a scenario's worlds to a new file; all of it or nothing.

    Args:
        path: of the Zarr group to make.
        simulator: of the scenario.
        advance: called with the number of worlds done after each tile.
        raw: write each array of each world as one file of plain little-endian numbers in C order,
            ``NAME/c/WORLD/0/0...``, that can be read without a Zarr library or a codec.
        extend: writes further arrays and attributes into the group, from all of its problems.

    Raises:
        ConfigError: the path exists.
        RunError: the path cannot be written.
    """
    total, tile = simulator.scenario.worlds, simulator.tile
    with results_folder.build_folder(path, kind="file of problems") as building:
        group = zarr.open_group(building, mode="a")
        written: list[Problem] = []
        for first in range(0, total, tile):
            problems = simulator.problems(first, min(tile, total - first))
            batch = jax.tree.map(
                lambda *rows: np.stack(rows), *(_without_name(problem) for problem in problems)
            )
            if first == 0:
                _create_arrays(group, problems[0], batch, simulator, raw=raw)
            for name, rows in _problem_arrays(batch).items():
                # A chunk of nothing but zeros is a file too: a reader without Zarr expects it.
                with zarr.config.set({"array.write_empty_chunks": raw}):
                    array = group.get_array(name)
                array[first : first + len(rows)] = rows
            advance(first + len(problems))
            if extend is not None:
                written += problems
        if extend is not None:
            extend(group, written)


def _without_name(problem: Problem) -> Problem:
    """Return a problem without its name, so that problems of a batch have one structure.

    Links of arms are left out too: files hold hulls in their home posture.
    """
    return replace(problem, name=None, team=replace(problem.team, arms=None))


def _problem_arrays(batch: Problem) -> dict[str, np.ndarray]:
    """Return arrays by their names in the file; components of the current are ``current/i``.

    Python's fields have ``current/components/i``.
    """
    return {
        name.replace("current/components/", "current/"): np.asarray(rows)
        for name, rows in named_leaves(batch).items()
    }


def _create_arrays(
    group: zarr.Group, first: Problem, batch: Problem, simulator: Simulator, *, raw: bool
) -> None:
    assert first.name is not None
    planner, worlds = simulator.scenario.planner, simulator.scenario.worlds
    current = tuple(type(component).__name__ for component in first.current.components)
    group.attrs.update(
        {
            "schema": SCHEMA,
            "schema_version": SCHEMA_VERSION,
            "world_frame": "x east, y north, z up; metres; water surface at z = 0",
            "cells": "cell (i, j, k) spans origin_m + cell_m * [i, i+1] x [j, j+1] x [k, k+1]",
            "quaternion": "wxyz, body to world",
            "obstacle_kinds": "0 sphere, 1 box, 2 capsule",
            "current": list(current),
            "current_stays": first.current.stays,
            "scenario": first.name.scenario,
            "preset": first.name.preset,
            "seed": first.name.seed,
            "digest": first.name.digest,
            "horizon_s": first.horizon_s,
            "goal_tolerance_m": first.goal_tolerance_m,
            "deadline_s": first.deadline_s,
            "margin_m": planner.margin_m,
            "max_points": planner.points,
            "information": asdict(first.information),
        }
    )
    chunk = 1 if raw else min(simulator.tile, worlds)
    for name, rows in _problem_arrays(batch).items():
        metadata = array_metadata.describe_array(name, current)
        group.create_array(
            name,
            shape=(worlds, *rows.shape[1:]),
            chunks=(chunk, *rows.shape[1:]),
            dtype=rows.dtype,
            compressors=None if raw else BloscCodec(cname="lz4", shuffle="shuffle", clevel=1),
            attributes=metadata.attributes(),
            dimension_names=["world", *metadata.axes],
        )
