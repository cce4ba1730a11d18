"""What a benchmark asks: scenarios out of its file, and the planners that are asked.

A `Setting` is a set of problems: worlds of one scenario and seed, with what may be known of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from angler_mjx.errors import ConfigError, shown
from angler_mjx.files import FOLDER, named, parse, read_toml
from angler_mjx.runs.simulator.on_device import device_planner
from angler_mjx.scenario.editing import merged, table_of, without_horizon
from angler_mjx.scenario.reachable import check_reachable
from angler_mjx.scenario.scenario import Scenario, load_beside
from angler_mjx.scenario.tables import InformationConfig
from angler_mjx.scenario.task_table import refuse_task
from angler_mjx.sim.information import Information
from angler_mjx.studies.benchmark import compared_planners as compared
from angler_mjx.studies.benchmark.compared_planners import ComparedPlanner
from angler_mjx.studies.benchmark.config import BenchmarkConfig

PLAIN = "as it is"
"""Name of the scene of a benchmark that names none."""


@dataclass(frozen=True, kw_only=True)
class Setting:
    """A set of problems: worlds 0, 1 and on of a scenario."""

    scene: str
    """Preset and scene, as tables call it."""
    robots: int
    knows: Information
    scenario: Scenario
    """With the number of worlds and the deadline."""
    seed: int
    """Of the worlds."""

    @property
    def preset(self) -> str:
        """Of its worlds."""
        return self.scenario.world.preset

    def told(self) -> Scenario:
        """The scenario, which says what may be known."""
        known = InformationConfig(obstacles=self.knows.obstacles, current=self.knows.current)
        planner = self.scenario.planner.model_copy(update={"knows": known})
        return self.scenario.model_copy(update={"planner": planner})

    def flown(self, one: ComparedPlanner, source: str = "") -> Scenario:
        """The scenario by which the robots of a contestant fly; see `compared_planners.flown`."""
        return compared.flown(self.scenario, self.knows, one, f"{source} ({self})")

    def __str__(self) -> str:
        return f"{self.scene}, {self.robots} robot{'s' if self.robots > 1 else ''}"


@dataclass(frozen=True, kw_only=True)
class Benchmark:
    """A benchmark file with all that it names."""

    config: BenchmarkConfig
    scenario: Scenario
    """That all problems are made of."""
    contestants: tuple[ComparedPlanner, ...]
    settings: tuple[Setting, ...]

    def asked(self, setting: Setting) -> list[ComparedPlanner]:
        """Who is asked the problems of a setting, in the file's order."""
        told = _told(self.config, self.scenario)
        return [
            one
            for one in self.contestants
            if (setting.knows == one.knows if one.knows else setting.knows in told)
            and (not one.teams or setting.robots in one.teams)
            and (not one.presets or setting.preset in one.presets)
        ]

    def blind(self) -> list[str]:
        """Return a line on each contestant that steers in flight and is not given what moves."""
        labels = {
            one.label
            for setting in self.settings
            for one in self.asked(setting)
            if (one.policy is not None or one.online.get("replan_hz"))
            and setting.knows.obstacles == "nothing"
            and setting.scenario.obstacles_move
        }
        return [
            f"planner {shown(label)} flies blind: it has no information about obstacles that move; "
            'give it knows = { obstacles = "observed" }'
            for label in sorted(labels)
        ]

    def resolved(self) -> dict[str, Any]:
        """All of it in plain values: the same table is the same benchmark."""
        return {
            "benchmark": self.config.model_dump(mode="json"),
            "scenario": self.scenario.model_dump(mode="json", exclude_unset=True),
            "planners": [{"label": one.label, "sha256": one.sha256} for one in self.contestants],
            "problems": sorted({setting.scenario.digest() for setting in self.settings}),
        }


def read(path: Path, **instead: Any) -> Benchmark:
    """A benchmark from its file.

    Args:
        path: of the file.
        **instead: top-level keys that replace those of the file.

    Raises:
        ConfigError: naming every fault of it, or the first of what it names.
        UnsupportedError: the libraries of a planner are not installed.
    """
    table = {**read_toml(path), **instead}
    source = str(path) + (f" with other {', '.join(instead)}" if instead else "")
    folder = path.absolute().parent
    config = parse(BenchmarkConfig, table, source=source, context={FOLDER: folder})
    scenario = load_beside(config.scenario, folder)
    refuse_task(scenario.task, f"{path}: planners are compared by ways to one goal; leave it out")
    return build(config, scenario, str(path))


def build(config: BenchmarkConfig, scenario: Scenario, source: str) -> Benchmark:
    """A benchmark from its table and its scenario.

    Args:
        config: with absolute paths.
        scenario: that all problems are made of.
        source: of the table, for messages.

    Raises:
        ConfigError, UnsupportedError: as `read`.
    """
    try:
        contestants = tuple(compared.build_compared_planner(one) for one in config.planner)
    except ConfigError as error:
        raise ConfigError(f"{named(source)}: {error}") from error
    settings = tuple(_settings(config, scenario, contestants, source))
    made = Benchmark(config=config, scenario=scenario, contestants=contestants, settings=settings)
    made = replace(made, settings=tuple(s for s in settings if made.asked(s)))
    if not made.settings:
        raise ConfigError(
            f"{named(source)}: presets and teams: no planner is asked any of them; see presets "
            "and teams of each [[planner]]"
        )
    for setting in made.settings:
        asked = made.asked(setting)
        if not (setting.scenario.world.currents and any(_may_be_carried(one) for one in asked)):
            check_reachable(setting.scenario, f"{named(source)} ({setting}): set.time.horizon_s")
        for one in asked:
            _require_able(one, setting, source)
    return made


def _require_able(one: ComparedPlanner, setting: Setting, source: str) -> None:
    """Refuse who can make no use of what is known, or cannot be flown as it is to be."""
    if one.on_device:
        try:
            device_planner(setting.told(), one.planner)
        except ConfigError as error:
            raise ConfigError(
                f"{named(source)}: planner {shown(one.label)}: {error}; or say in its table "
                "what it is told, by knows"
            ) from error
    setting.flown(one, named(source))


def _may_be_carried(one: ComparedPlanner) -> bool:
    """Whether it may be faster over ground than the cruise speed."""
    return one.flies_itself or one.name == "current"


def _settings(
    config: BenchmarkConfig,
    scenario: Scenario,
    contestants: tuple[ComparedPlanner, ...],
    source: str,
) -> list[Setting]:
    for table in (config.set, *(one.set for one in config.scene)):
        _require_ours_left(table, source)
    base = table_of(scenario)
    base["worlds"] = config.problems
    base["planner"] = {
        "margin_m": scenario.planner.margin_m,
        "points": config.points or scenario.planner.points,
        "deadline_s": config.deadline_s,
    }
    base["policy"] = {**base.get("policy", {}), "name": "none"}
    # Contestants fly plans of their own, and auto goes by the planner that it chose.
    if scenario.execution.by_auto:
        base["execution"] = {"order": "free"}
    if config.presets:  # The scenario's horizon is that of its own world.
        base = without_horizon(base)
    base = merged(base, config.set)
    known = [] if all(one.knows for one in contestants) else _told(config, scenario)
    known += [one.knows for one in contestants if one.knows is not None]
    made = []
    for preset in config.presets or (None,):
        for scene in config.scene or (None,):
            table = merged(base, {} if scene is None else scene.set)
            if preset is not None:
                table = merged(table, {"world": {"preset": preset}})
            names = [text for text in (preset, None if scene is None else scene.name) if text]
            called = " ".join(names) or PLAIN
            whole = parse(Scenario, table, source=f"{source} ({called})")
            for team in config.teams or (None,):
                found = whole if team is None else with_team(whole, table, team, source, called)
                made += [
                    Setting(
                        scene=called,
                        robots=len(found.members()),
                        knows=knows,
                        scenario=found,
                        seed=seed,
                    )
                    for seed in config.seeds or (found.seed,)
                    for knows in dict.fromkeys(known)
                ]
    return made


OURS = {
    "worlds": "problems",
    "seed": "seeds",
    "planner.name": "[[planner]]",
    "planner.settings": "settings in [[planner]]",
    "planner.points": "points",
    "planner.deadline_s": "deadline_s",
    "planner.knows": "[[knows]]",
    "planner.replan_hz": "replan_hz in [[planner]]",
    "planner.delay_s": "delay_s in [[planner]]",
    "policy.name": "policy in [[planner]]",
}
"""Keys of a scenario that a benchmark file says by keys of its own."""


def _require_ours_left(table: Mapping[str, Any], source: str) -> None:
    """Refuse changes of a scenario that a key of the benchmark stands for."""
    for key, instead in OURS.items():
        name, _, inner = key.partition(".")
        held = table.get(name)
        if name in table and (not inner or (isinstance(held, Mapping) and inner in held)):
            raise ConfigError(f"{named(source)}: set.{key}: give {instead} instead")


def with_team(
    whole: Scenario, table: Mapping[str, Any], robots: int, source: str, called: str
) -> Scenario:
    """A scenario with another number of robots."""
    entries = table_of(whole)["fleet"]
    about = f"{source} ({called}, {robots} robots)"
    return parse(Scenario, {**table, "fleet": _fleet(entries, robots)}, source=about)


def _told(config: BenchmarkConfig, scenario: Scenario) -> list[Information]:
    """What planners are told that do not say themselves."""
    return [one.knows() for one in config.knows or (scenario.planner.knows,)]


def _fleet(entries: Sequence[dict[str, Any]], robots: int) -> list[dict[str, Any]]:
    """Entries of a team of another size: as near to their shares as whole robots can be."""
    counts = [entry.get("count", 1) for entry in entries]
    exact = [count * robots / sum(counts) for count in counts]
    shares = [int(share) for share in exact]
    rest = sorted(range(len(exact)), key=lambda i: (shares[i] - exact[i], i))
    for i in rest[: robots - sum(shares)]:
        shares[i] += 1
    return [
        {**entry, "count": share} for entry, share in zip(entries, shares, strict=True) if share > 0
    ]


def again(building: Path, table: Mapping[str, Any], files: Mapping[str, str]) -> Benchmark:
    """A benchmark from what its results folder keeps of it.

    Args:
        building: the folder, for messages.
        table: of `Benchmark.resolved`.
        files: copies of planner files, by the paths that they had.
    """
    source = str(building)
    config = parse(BenchmarkConfig, table["benchmark"], source=source)
    scenario = parse(Scenario, table["scenario"], source=source)
    planners = tuple(
        one.model_copy(update={"name": _copied(one.name, files), "label": one.title})
        for one in config.planner
    )
    return build(config.model_copy(update={"planner": planners}), scenario, source)


def _copied(name: str, files: Mapping[str, str]) -> str:
    path, colon, qualname = name.rpartition(":")
    return f"{files.get(path, path)}:{qualname}" if colon and path.endswith(".py") else name
