"""The parts of a dataset: for each scene, size of team and expert one run, with its own seed."""

import hashlib
import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.files import FOLDER, named, parse, read_toml
from angler_mjx.learning.datasets.config import DatasetConfig, DatasetScene, Expert
from angler_mjx.runs.several import RUNS
from angler_mjx.scenario.editing import merged, table_of, without_horizon
from angler_mjx.scenario.scenario import Scenario, load_beside
from angler_mjx.scenario.task_table import refuse_task
from angler_mjx.studies.benchmark.questions import with_team


@dataclass(frozen=True, kw_only=True)
class DatasetPart:
    """A run of a dataset."""

    path: str
    """Below the dataset's folder, with slashes."""
    scene: str
    expert: str
    """Its label."""
    robots: int
    split: str | None
    """Of all its episodes; None where their environments decide."""
    scenario: Scenario
    """With its worlds and its seed."""


def read(path: Path) -> tuple[DatasetConfig, dict[str, Any]]:
    """A dataset file, and the table of the scenario that it is made of.

    Raises:
        ConfigError: naming every fault of the file.
    """
    folder = path.absolute().parent
    config = parse(DatasetConfig, read_toml(path), source=str(path), context={FOLDER: folder})
    scenario = load_beside(config.scenario, folder)
    refuse_task(scenario.task, f"{path}: experts plan ways to one goal; leave it out")
    return config, table_of(scenario)


def parts(
    config: DatasetConfig, table: Mapping[str, Any], episodes: int, source: str
) -> tuple[DatasetPart, ...]:
    """What is to be flown.

    Args:
        config: the file.
        table: of the scenario that it is made of.
        episodes: of all parts together.
        source: of the file, for messages.

    Raises:
        ConfigError: a scene or an expert cannot be flown so, or the episodes are too few.
    """
    cells = [
        (scene, team, expert, weight)
        for scene in config.scene
        for team in scene.teams or (None,)
        for expert, weight in _experts(config, scene, team, table)
    ]
    if not cells:
        raise ConfigError(
            f"{named(source)}: expert: none of them flies any scene; see its presets and teams"
        )
    total = sum(weight for *_, weight in cells)
    counts = _shares([weight / total for *_, weight in cells], episodes)
    if min(counts) < 1:
        scene, _, expert, _ = cells[counts.index(min(counts))]
        raise ConfigError(
            f"--episodes {episodes}: scene {scene.name!r}, expert {expert.title!r} would get none "
            f"of them; give {_least([w / total for *_, w in cells])} or more, or fewer scenes, "
            "teams or experts"
        )
    return tuple(
        _part(config, table, cell, count, number, source)
        for number, (cell, count) in enumerate(zip(cells, counts, strict=True))
    )


def _experts(
    config: DatasetConfig, scene: DatasetScene, team: int | None, table: Mapping[str, Any]
) -> list[tuple[Expert, float]]:
    """Who flies a scene with a team, and their weights."""
    preset = merged(merged(table, config.set), scene.set)["world"].get("preset")
    there = [
        one
        for one in config.expert
        if (not one.presets or preset in one.presets)
        and (not one.teams or team is None or team in one.teams)
    ]
    total = sum(one.weight for one in there)
    share = scene.weight / len(scene.teams or (None,))
    return [(one, share * one.weight / total) for one in there]


def _part(
    config: DatasetConfig,
    table: Mapping[str, Any],
    cell: tuple[DatasetScene, int | None, Expert, float],
    worlds: int,
    number: int,
    source: str,
) -> DatasetPart:
    scene, team, expert, _ = cell
    about = f"{source} (scene {scene.name}, expert {expert.title})"
    whole = merged(merged(table, config.set), scene.set)
    if "preset" in scene.set.get("world", {}) and "horizon_s" not in {
        **config.set.get("time", {}),
        **scene.set.get("time", {}),
    }:  # The scenario's horizon is that of its own world.
        whole = without_horizon(whole)
    whole |= _flown(whole, expert)
    whole |= {"worlds": worlds, "seed": seed_of(config.seed, number)}
    made = parse(Scenario, whole, source=about)
    if team is not None:
        made = with_team(made, whole, team, source, f"scene {scene.name}, expert {expert.title}")
    try:
        made.planner.chosen()
    except ConfigError as error:
        raise ConfigError(f"{named(about)}: {error}") from error
    robots = len(made.members())
    label = re.sub(r"[^A-Za-z0-9_-]+", "_", expert.title).strip("_")
    return DatasetPart(
        path=f"{RUNS}/{number:03d}_{scene.name}_{robots}_{label}",
        scene=scene.name,
        expert=expert.title,
        robots=robots,
        split=scene.split,
        scenario=made.model_copy(update={"name": config.name}),
    )


def _flown(table: Mapping[str, Any], expert: Expert) -> dict[str, Any]:
    """What of a scenario an expert says."""
    knows = {} if expert.knows is None else {"knows": expert.knows.model_dump()}
    if expert.policy is not None:
        own = {expert.policy: expert.settings} if expert.settings else {}
        policy = {"name": expert.policy, **knows, **own}
        return {"policy": merged(table.get("policy", {}), policy)}
    own = {expert.name.rpartition(":")[2]: expert.settings} if expert.settings else {}
    online = {key: x for key, x in expert.online.items() if key != "order"}
    planner = {
        **{key: x for key, x in table.get("planner", {}).items() if key in _KEPT},
        "name": expert.name,
        **knows,
        **online,
        "settings": own,
    }
    order = {"execution": {"order": expert.order}} if expert.order else {}
    return {"planner": planner, **order}


_KEPT = ("margin_m", "points", "deadline_s", "knows")
"""Of a scenario's planner, whoever plans."""


def seed_of(seed: int, number: int) -> int:
    """Seed of a part, so that no two parts of a dataset fly in the same worlds."""
    text = f"angler dataset {seed} part {number}".encode()
    return int.from_bytes(hashlib.sha256(text).digest()[:4], "big") >> 1


def _shares(shares: list[float], whole: int) -> list[int]:
    """A whole number as near to its shares as whole numbers can be."""
    counts = [int(share * whole) for share in shares]
    rest = sorted(range(len(shares)), key=lambda i: (counts[i] - shares[i] * whole, i))
    for i in rest[: whole - sum(counts)]:
        counts[i] += 1
    return counts


def _least(shares: list[float]) -> int:
    """Fewest episodes of which every part gets one."""
    most = round(1.0 / min(shares)) + len(shares)
    return next((n for n in range(len(shares), most) if min(_shares(shares, n)) >= 1), most)
