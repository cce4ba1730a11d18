"""Parts of a dataset: one run for each scene, team size and expert, with its own seed."""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.files import FOLDER_CONTEXT, format_path, parse_model, read_toml
from angler_mjx.learning.datasets.config import DatasetConfig, DatasetScene, Expert
from angler_mjx.runs.multi_run import RUNS_FOLDER
from angler_mjx.scenario.carry_table import CarryTask
from angler_mjx.scenario.editing import merge_tables, remove_horizon, scenario_table
from angler_mjx.scenario.scenario import Scenario, load_relative_scenario
from angler_mjx.scenario.task_table import require_goal_task
from angler_mjx.studies.benchmark.compared_planners import build_pilot_tables
from angler_mjx.studies.benchmark.problem_settings import with_team


@dataclass(frozen=True, kw_only=True)
class DatasetPart:
    """Run of a dataset."""

    path: str
    """Path below the dataset's folder, with slashes."""
    scene: str
    expert: str
    """Label of the expert."""
    robots: int
    split: str | None
    """Split of all its episodes; None where their environments decide."""
    scenario: Scenario
    """Scenario with its worlds and its seed."""


def read_config(path: Path) -> tuple[DatasetConfig, dict[str, Any]]:
    """Read a dataset file, and the table of its scenario.

    Raises:
        ConfigError: the file has faults; the message names all.
    """
    folder = path.absolute().parent
    config = parse_model(
        DatasetConfig, read_toml(path), source=str(path), context={FOLDER_CONTEXT: folder}
    )
    scenario = load_relative_scenario(config.scenario, folder)
    require_goal_task(
        scenario.task, f"{path}: experts plan ways to one goal; leave it out", also=(CarryTask,)
    )
    return config, scenario_table(scenario)


def build_parts(
    config: DatasetConfig, table: Mapping[str, Any], episodes: int, source: str
) -> tuple[DatasetPart, ...]:
    """Build the parts to fly.

    Args:
        config: dataset file.
        table: table of its scenario.
        episodes: number of episodes of all parts together.
        source: name of the file, for messages.

    Raises:
        ConfigError: a scene or an expert cannot be flown so, or the episodes are too few.
    """
    cells = [
        (scene, team, expert, weight)
        for scene in config.scene
        for team in scene.teams or (None,)
        for expert, weight in _select_experts(config, scene, team, table)
    ]
    if not cells:
        raise ConfigError(
            f"{format_path(source)}: expert: none of them flies any scene; see its presets and "
            "teams"
        )
    total = sum(weight for *_, weight in cells)
    counts = _apportion([weight / total for *_, weight in cells], episodes)
    if min(counts) < 1:
        scene, _, expert, _ = cells[counts.index(min(counts))]
        raise ConfigError(
            f"--episodes {episodes}: scene {scene.name!r}, expert {expert.title!r} would get none "
            f"of them; give {_min_episodes([w / total for *_, w in cells])} or more, or fewer "
            "scenes, "
            "teams or experts"
        )
    return tuple(
        _build_part(config, table, cell, count, number, source)
        for number, (cell, count) in enumerate(zip(cells, counts, strict=True))
    )


def _select_experts(
    config: DatasetConfig, scene: DatasetScene, team: int | None, table: Mapping[str, Any]
) -> list[tuple[Expert, float]]:
    """Return the experts of a scene with a team, and their weights."""
    preset = merge_tables(merge_tables(table, config.set), scene.set)["world"].get("preset")
    matching = [
        expert
        for expert in config.expert
        if (not expert.presets or preset in expert.presets)
        and (not expert.teams or team is None or team in expert.teams)
    ]
    total = sum(expert.weight for expert in matching)
    fraction = scene.weight / len(scene.teams or (None,))
    return [(expert, fraction * expert.weight / total) for expert in matching]


def _build_part(
    config: DatasetConfig,
    table: Mapping[str, Any],
    cell: tuple[DatasetScene, int | None, Expert, float],
    worlds: int,
    number: int,
    source: str,
) -> DatasetPart:
    scene, team, expert, _ = cell
    source_name = f"{source} (scene {scene.name}, expert {expert.title})"
    scenario_table = merge_tables(merge_tables(table, config.set), scene.set)
    if "preset" in scene.set.get("world", {}) and "horizon_s" not in {
        **config.set.get("time", {}),
        **scene.set.get("time", {}),
    }:  # The scenario's horizon is that of its own world.
        scenario_table = remove_horizon(scenario_table)
    scenario_table |= _build_expert_tables(scenario_table, expert)
    scenario_table |= {"worlds": worlds, "seed": part_seed(config.seed, number)}
    if scenario_table.get("task", {}).get("type") == "carry":
        scenario_table = _record_grips(scenario_table)
    scenario = parse_model(Scenario, scenario_table, source=source_name)
    if team is not None:
        scenario = with_team(
            scenario, scenario_table, team, source, f"scene {scene.name}, expert {expert.title}"
        )
    try:
        scenario.planner.planner_spec()
    except ConfigError as error:
        raise ConfigError(f"{format_path(source_name)}: {error}") from error
    robots = len(scenario.members())
    label = re.sub(r"[^A-Za-z0-9_-]+", "_", expert.title).strip("_")
    return DatasetPart(
        path=f"{RUNS_FOLDER}/{number:03d}_{scene.name}_{robots}_{label}",
        scene=scene.name,
        expert=expert.title,
        robots=robots,
        split=scene.split,
        scenario=scenario.model_copy(update={"name": config.name}),
    )


def _record_grips(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return the table of a scenario that records the grips of its robots."""
    also = tuple(table.get("store", {}).get("also", ()))
    return merge_tables(table, {"store": {"also": [*also, *({"grips"} - set(also))]}})


def _build_expert_tables(table: Mapping[str, Any], expert: Expert) -> dict[str, dict[str, object]]:
    """Return the scenario tables that an expert replaces."""
    information = None if expert.information is None else expert.information.model_dump()
    tables = build_pilot_tables(expert, information)
    if expert.policy is not None:
        base = {**table.get("policy", {}), "settings": {}}  # those of the scenario's own class
        return {"policy": merge_tables(base, tables["policy"])}
    common = {key: x for key, x in table.get("planner", {}).items() if key in _PLANNER_KEYS}
    return {**tables, "planner": {**common, **tables["planner"]}}


_PLANNER_KEYS = ("margin_m", "points", "deadline_s", "information")
"""Keys of a scenario's planner that hold for every planner."""


def part_seed(seed: int, number: int) -> int:
    """Return the seed of a part, so that no two parts of a dataset sample the same worlds."""
    text = f"angler dataset {seed} part {number}".encode()
    return int.from_bytes(hashlib.sha256(text).digest()[:4], "big") >> 1


def _apportion(fractions: list[float], total: int) -> list[int]:
    """Split a whole number by fractions, as closely as whole numbers can."""
    counts = [int(fraction * total) for fraction in fractions]
    rest = sorted(range(len(fractions)), key=lambda i: (counts[i] - fractions[i] * total, i))
    for i in rest[: total - sum(counts)]:
        counts[i] += 1
    return counts


def _min_episodes(fractions: list[float]) -> int:
    """Return the least number of episodes of which every part gets one."""
    max_episodes = round(1.0 / min(fractions)) + len(fractions)
    return next(
        (n for n in range(len(fractions), max_episodes) if min(_apportion(fractions, n)) >= 1),
        max_episodes,
    )
