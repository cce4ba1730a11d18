"""What a benchmark asks: scenarios out of its file, and the planners that are asked.

A `Setting` is a set of problems: worlds of one scenario and seed, with what may be known of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FOLDER_CONTEXT, format_path, parse_model, read_toml
from angler_mjx.runs.simulator.world_preparation import check_planner
from angler_mjx.scenario.carry_table import CarryTask
from angler_mjx.scenario.editing import merge_tables, remove_horizon, scenario_table
from angler_mjx.scenario.horizon_check import check_reachable
from angler_mjx.scenario.policy_of_file import is_policy_class
from angler_mjx.scenario.policy_tables import POLICIES
from angler_mjx.scenario.scenario import Scenario, load_relative_scenario
from angler_mjx.scenario.tables import InformationConfig
from angler_mjx.scenario.task_table import require_goal_task
from angler_mjx.sim.information import Information
from angler_mjx.studies.benchmark import compared_planners as compared
from angler_mjx.studies.benchmark.compared_planners import ComparedPlanner
from angler_mjx.studies.benchmark.config import BenchmarkConfig
from angler_mjx.studies.grid import (
    GridCell,
    build_changes_axis,
    find_reserved_key,
    iterate_cells,
)
from angler_mjx.user_classes import is_class_of_file, make_name_absolute

RESERVED_KEYS = {
    "worlds": "problems",
    "seed": "seeds",
    "planner.name": "[[planner]]",
    "planner.settings": "settings in [[planner]]",
    "planner.points": "points",
    "planner.deadline_s": "deadline_s",
    "planner.information": "[[information]]",
    "planner.replan_hz": "replan_hz in [[planner]]",
    "planner.delay_s": "delay_s in [[planner]]",
    "policy.name": "policy in [[planner]]",
}
"""Keys of a scenario that a benchmark file says by keys of its own."""

DEFAULT_SCENE = "as it is"
"""Name of the scene of a benchmark that names none."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """A set of problems: worlds 0, 1 and on of a scenario."""

    scene: str
    """Preset and scene, as tables call it."""
    robots: int
    information: Information
    scenario: Scenario
    """With the number of worlds and the deadline."""
    seed: int
    """Of the worlds."""

    @property
    def preset(self) -> str:
        """Of its worlds."""
        return self.scenario.world.preset

    def informed_scenario(self) -> Scenario:
        """The scenario, which says what may be known."""
        information = InformationConfig(
            obstacles=self.information.obstacles, current=self.information.current
        )
        planner = self.scenario.planner.model_copy(update={"information": information})
        return self.scenario.model_copy(update={"planner": planner})

    def flown(self, planner: ComparedPlanner, source: str = "") -> Scenario:
        """Return the scenario of flights; see `compared_planners.build_flown_scenario`."""
        return compared.build_flown_scenario(
            self.scenario, self.information, planner, f"{source} ({self})"
        )

    def __str__(self) -> str:
        return f"{self.scene}, {self.robots} robot{'s' if self.robots > 1 else ''}"


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A benchmark file with all that it names."""

    config: BenchmarkConfig
    scenario: Scenario
    """That all problems are made of."""
    planners: tuple[ComparedPlanner, ...]
    settings: tuple[Setting, ...]

    def select_planners(self, setting: Setting) -> list[ComparedPlanner]:
        """Who is asked the problems of a setting, in the file's order."""
        default_information = _default_information(self.config, self.scenario)
        return [
            planner
            for planner in self.planners
            if (
                setting.information == planner.information
                if planner.information
                else setting.information in default_information
            )
            and (not planner.teams or setting.robots in planner.teams)
            and (not planner.presets or setting.preset in planner.presets)
        ]

    def list_blind_planners(self) -> list[str]:
        """Return a line on each contestant that steers in flight and is not given what moves."""
        labels = {
            planner.label
            for setting in self.settings
            for planner in self.select_planners(setting)
            if (planner.policy is not None or planner.online.get("replan_hz"))
            and setting.information.obstacles == "nothing"
            and setting.scenario.obstacles_move
        }
        return [
            f"planner {format_value(label)} flies blind: it has no information about obstacles "
            "that move; "
            'give it information = { obstacles = "observed" }'
            for label in sorted(labels)
        ]

    def resolved(self) -> dict[str, object]:
        """All of it in plain values: the same table is the same benchmark."""
        scenario = self.scenario.model_dump(mode="json", exclude_unset=True)
        if self.scenario.policy.file is not None:  # no contestant flies by it
            scenario["policy"] = {"name": "none"}
        return {
            "benchmark": self.config.model_dump(mode="json"),
            "scenario": scenario,
            "planners": [
                {"label": planner.label, "sha256": planner.sha256} for planner in self.planners
            ],
            "problems": sorted({setting.scenario.digest() for setting in self.settings}),
        }


def read_benchmark(
    path: Path, *, planners: Sequence[str] | None = None, **overrides: object
) -> Benchmark:
    """A benchmark from its file.

    Args:
        path: of the file.
        planners: names of the compared planners and policies, as `select_entries` takes them; the
            file's if None.
        **overrides: top-level keys that replace those of the file.

    Raises:
        ConfigError: naming every fault of it, or the first of what it names.
        UnsupportedError: the libraries of a planner are not installed.
    """
    table = {**read_toml(path), **overrides}
    if planners is not None:
        table["planner"] = select_entries(table.get("planner"), planners, Path.cwd())
    other = [*overrides, *([] if planners is None else ["planner"])]
    source = str(path) + (f" with other {', '.join(other)}" if other else "")
    folder = path.absolute().parent
    config = parse_model(BenchmarkConfig, table, source=source, context={FOLDER_CONTEXT: folder})
    scenario = load_relative_scenario(config.scenario, folder)
    require_goal_task(
        scenario.task,
        f"{path}: planners are compared by ways to one goal; leave it out",
        also=(CarryTask,),
    )
    return build_benchmark(config, scenario, str(path))


def select_entries(entries: object, names: Sequence[str], folder: Path) -> list[object]:
    """Return tables of [[planner]] for names.

    Args:
        entries: tables of a benchmark file, unchecked. A name selects those of that label, name or
            policy.
        names: labels of entries, planners, FILE.py:CLASS, or policies; a name that selects no entry
            makes one with default settings.
        folder: base of the paths of files.
    """
    listed = (
        [entry for entry in entries if isinstance(entry, dict)] if isinstance(entries, list) else []
    )
    selected: list[object] = []
    for name in names:
        path = make_name_absolute(name, folder)
        made = {"policy" if _is_policy(path) else "name": path}
        selected += [
            entry
            for entry in listed
            if name in (entry.get("label"), entry.get("name"), entry.get("policy"))
        ] or [made]
    return selected


def _is_policy(name: str) -> bool:
    """Return whether a name is that of a policy, of the package or of a file."""
    return name in POLICIES or (is_class_of_file(name) and is_policy_class(name))


def build_benchmark(config: BenchmarkConfig, scenario: Scenario, source: str) -> Benchmark:
    """A benchmark from its table and its scenario.

    Args:
        config: with absolute paths.
        scenario: that all problems are made of.
        source: of the table, for messages.

    Raises:
        ConfigError, UnsupportedError: as `read_benchmark`.
    """
    try:
        planners = tuple(compared.build_compared_planner(planner) for planner in config.planner)
    except ConfigError as error:
        raise ConfigError(f"{format_path(source)}: {error}") from error
    settings = tuple(_build_settings(config, scenario, planners, source))
    benchmark = Benchmark(config=config, scenario=scenario, planners=planners, settings=settings)
    benchmark = replace(
        benchmark, settings=tuple(s for s in settings if benchmark.select_planners(s))
    )
    if not benchmark.settings:
        raise ConfigError(
            f"{format_path(source)}: presets and teams: no planner is asked any of them; see "
            "presets "
            "and teams of each [[planner]]"
        )
    for setting in benchmark.settings:
        selected = benchmark.select_planners(setting)
        if not (
            setting.scenario.world.currents
            and any(_may_be_carried(planner) for planner in selected)
        ):
            check_reachable(
                setting.scenario, f"{format_path(source)} ({setting}): set.time.horizon_s"
            )
        for planner in selected:
            _require_usable(planner, setting, source)
    return benchmark


def _require_usable(planner: ComparedPlanner, setting: Setting, source: str) -> None:
    """Refuse who can make no use of what is known, or cannot be flown as it is to be."""
    if planner.on_device:
        try:
            check_planner(setting.informed_scenario(), planner.planner)
        except ConfigError as error:
            raise ConfigError(
                f"{format_path(source)}: planner {format_value(planner.label)}: {error}; or say in "
                "its "
                "table "
                "its levels, by information"
            ) from error
    setting.flown(planner, format_path(source))


def _may_be_carried(planner: ComparedPlanner) -> bool:
    """Whether it may be faster over ground than the cruise speed."""
    return planner.flies_itself or planner.name == "current"


def _build_settings(
    config: BenchmarkConfig,
    scenario: Scenario,
    planners: tuple[ComparedPlanner, ...],
    source: str,
) -> list[Setting]:
    base = _build_base_table(config, scenario, source)
    information_options = _list_information(config, scenario, planners)
    settings = []
    for cell in _list_scenes(config):
        table = cell.edit(base)
        scene = " ".join(reversed(cell.names.values())) or DEFAULT_SCENE
        whole = parse_model(Scenario, table, source=f"{source} ({scene})")
        for team in config.teams or (None,):
            team_scenario = whole if team is None else with_team(whole, table, team, source, scene)
            settings += [
                Setting(
                    scene=scene,
                    robots=len(team_scenario.members()),
                    information=information,
                    scenario=team_scenario,
                    seed=seed,
                )
                for seed in config.seeds or (team_scenario.seed,)
                for information in information_options
            ]
    return settings


def _list_scenes(config: BenchmarkConfig) -> list[GridCell]:
    """Return the cells of scenes and presets; the scene changes fastest, the preset is set last."""
    scenes = {entry.name: entry.set for entry in config.scene}
    presets = {name: {"world": {"preset": name}} for name in config.presets}
    axes = [
        build_changes_axis(*axis) for axis in (("scene", scenes), ("preset", presets)) if axis[1]
    ]
    return sorted(iterate_cells(axes), key=lambda cell: cell.indices[::-1])


def _build_base_table(config: BenchmarkConfig, scenario: Scenario, source: str) -> dict[str, Any]:
    """Return the table of the scenario that scenes and teams are made of."""
    for table in (config.set, *(entry.set for entry in config.scene)):
        if fault := find_reserved_key(table, RESERVED_KEYS):
            raise ConfigError(f"{format_path(source)}: set.{fault}")
    base = scenario_table(scenario)
    base["worlds"] = config.problems
    base["planner"] = {
        "margin_m": scenario.planner.margin_m,
        "points": config.points or scenario.planner.points,
        "deadline_s": config.deadline_s,
    }
    base["policy"] = {**base.get("policy", {}), "name": "none", "settings": {}}
    # Contestants fly plans of their own, and auto goes by the planner that it chose.
    if scenario.execution.by_auto:
        base["execution"] = {"order": "free"}
    if config.presets:  # The scenario's horizon is that of its own world.
        base = remove_horizon(base)
    return merge_tables(base, config.set)


def _list_information(
    config: BenchmarkConfig, scenario: Scenario, planners: Sequence[ComparedPlanner]
) -> list[Information]:
    """Return all levels that any planner is given, each once."""
    planner_options = [entry.information for entry in planners]
    default = _default_information(config, scenario) if None in planner_options else []
    return list(dict.fromkeys([*default, *(x for x in planner_options if x is not None)]))


def with_team(
    whole: Scenario, table: Mapping[str, object], robots: int, source: str, scene_name: str
) -> Scenario:
    """A scenario with another number of robots."""
    entries = scenario_table(whole)["fleet"]
    about = f"{source} ({scene_name}, {robots} robots)"
    return parse_model(Scenario, {**table, "fleet": _scale_fleet(entries, robots)}, source=about)


def _default_information(config: BenchmarkConfig, scenario: Scenario) -> list[Information]:
    """What planners are told that do not say themselves."""
    return [
        entry.to_information() for entry in config.information or (scenario.planner.information,)
    ]


def _scale_fleet(entries: Sequence[dict[str, Any]], robots: int) -> list[dict[str, Any]]:
    """Entries of a team of another size: as near to their shares as whole robots can be."""
    counts = [entry.get("count", 1) for entry in entries]
    exact = [count * robots / sum(counts) for count in counts]
    rounded = [int(number) for number in exact]
    rest = sorted(range(len(exact)), key=lambda i: (rounded[i] - exact[i], i))
    for i in rest[: robots - sum(rounded)]:
        rounded[i] += 1
    return [
        {**entry, "count": number}
        for entry, number in zip(entries, rounded, strict=True)
        if number > 0
    ]


def rebuild_benchmark(
    building: Path, table: Mapping[str, Any], files: Mapping[str, str]
) -> Benchmark:
    """A benchmark from what its results folder keeps of it.

    Args:
        building: the folder, for messages.
        table: of `Benchmark.resolved`.
        files: copies of files of planners and policies, by the paths that they had.
    """
    source = str(building)
    config = parse_model(BenchmarkConfig, table["benchmark"], source=source)
    scenario = parse_model(Scenario, table["scenario"], source=source)
    planners = tuple(
        entry.model_copy(
            update={
                "name": _copied_name(entry.name, files),
                "policy": entry.policy and _copied_name(entry.policy, files),
                "label": entry.title,
            }
        )
        for entry in config.planner
    )
    return build_benchmark(config.model_copy(update={"planner": planners}), scenario, source)


def _copied_name(name: str, files: Mapping[str, str]) -> str:
    path, colon, qualname = name.rpartition(":")
    return f"{files.get(path, path)}:{qualname}" if colon and path.endswith(".py") else name
