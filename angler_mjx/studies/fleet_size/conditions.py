"""What a fleet-size study asks: conditions, and the scenario of each with a team of each size."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import FOLDER_CONTEXT, format_path, parse_model, read_toml
from angler_mjx.runs.simulator.world_preparation import check_planner
from angler_mjx.scenario.editing import merge_tables, scenario_table, set_value
from angler_mjx.scenario.horizon_check import check_reachable
from angler_mjx.scenario.scenario import Scenario, load_relative_scenario
from angler_mjx.studies.fleet_size.config import FleetSizeConfig
from angler_mjx.studies.grid import build_changes_axis, iterate_cells

DEFAULT_CONDITION = "as it is"
"""Name of the only condition of a study that names none."""


@dataclass(frozen=True, kw_only=True)
class Condition:
    """Worlds and robots of one kind."""

    name: str
    values: Mapping[str, str]
    """Of each axis, by name."""
    table: Mapping[str, object]
    """Of its scenario."""


@dataclass(frozen=True, kw_only=True)
class FleetSizeStudy:
    """A fleet-size file with all that it names."""

    config: FleetSizeConfig
    source: str
    """Of the file, for messages."""
    table: Mapping[str, object]
    """Of the scenario as its file says it."""
    conditions: tuple[Condition, ...]
    sizes: tuple[int, ...]
    _made: dict[tuple[str, int], Scenario] = field(default_factory=dict, repr=False, compare=False)

    def scenario(self, condition: Condition, size: int) -> Scenario:
        """What is flown in a condition by a team of a size.

        Raises:
            ConfigError: it cannot be flown.
        """
        key = (condition.name, size)
        if key not in self._made:
            self._made[key] = self._scenario(condition, size)
        return self._made[key]

    def _scenario(self, condition: Condition, size: int) -> Scenario:
        where = (
            f"{format_path(self.source)} ({condition.name}, {size} robot{'s' if size > 1 else ''})"
        )
        try:
            table = {key: _tuples_to_lists(value) for key, value in condition.table.items()}
            table = set_value(table, self.config.size.key, size)
        except ConfigError as error:
            raise ConfigError(f"{where}: size.key: {error}") from error
        scenario = parse_model(Scenario, table, source=where)
        check_planner(scenario)
        return scenario

    def resolved(self) -> dict[str, object]:
        """All of it in plain values: the same table is the same study."""
        config = self.config.model_dump(mode="json", by_alias=True)
        config["budget"].pop("max_minutes")
        return {
            "study": config,
            "scenario": dict(self.table),
            "conditions": [condition.name for condition in self.conditions],
            "problems": [
                self.scenario(condition, self.sizes[0]).digest() for condition in self.conditions
            ],
        }


def read_study(
    path: Path, only: Sequence[str] = (), *, smoke: bool = False, **budget: float | None
) -> FleetSizeStudy:
    """A study from its file.

    Args:
        path: of the file.
        only: names of conditions; all of the file if empty.
        smoke: two sizes and a few worlds, to see that it runs.
        **budget: keys of its table budget that are otherwise.

    Raises:
        ConfigError: naming every fault of it, or the first of what it names.
    """
    table = read_toml(path)
    limits = {key: value for key, value in budget.items() if value is not None}
    if limits and smoke:
        flags = ", ".join(f"--{key.replace('_', '-')}" for key in limits)
        raise ConfigError(
            f"--smoke: has a budget of its own, four worlds a size; leave out {flags}"
        )
    if limits:
        table = merge_tables(table, {"budget": limits})
    folder = path.absolute().parent
    config = parse_model(FleetSizeConfig, table, source=str(path), context={FOLDER_CONTEXT: folder})
    config = config.smoke() if smoke else config
    return build_study(
        config, scenario_table(load_relative_scenario(config.scenario, folder)), str(path), only
    )


def build_study(
    config: FleetSizeConfig, table: Mapping[str, object], source: str, only: Sequence[str] = ()
) -> FleetSizeStudy:
    """A study from its table and that of its scenario.

    Args:
        config: of the study.
        table: of `scenario.editing.scenario_table`.
        source: for messages.
        only: as of `read_study`.

    Raises:
        ConfigError: as `read_study`.
    """
    batches = -(-config.budget.max_worlds // config.budget.batch)
    base = merge_tables(
        merge_tables(table, config.set),
        {"worlds": batches * config.budget.batch, "seed": config.seed},
    )
    study = FleetSizeStudy(
        config=config,
        source=source,
        table=table,
        conditions=_select_conditions(_build_conditions(config, base), only, source),
        sizes=config.all_sizes(),
    )
    for condition in study.conditions:
        for size in (study.sizes[0], study.sizes[-1]):
            _check_condition(study, condition, size)
    return study


def _check_condition(study: FleetSizeStudy, condition: Condition, size: int) -> None:
    """Refuse what no world can decide, or no robot can do."""
    scenario = study.scenario(condition, size)
    where = f"{format_path(study.source)} ({condition.name})"
    deadline_s, horizon_s = study.config.deadline_s, scenario.time.horizon_s
    if deadline_s > horizon_s:
        raise ConfigError(
            f"{where}: deadline_s = {deadline_s:g}: worlds end after time.horizon_s = "
            f"{horizon_s:g}; give a deadline of at most that, or set.time.horizon_s"
        )
    if scenario.task_spec() is None:
        check_reachable(scenario, f"{where}: set.time.horizon_s")
        return
    key = "fraction" if study.config.fraction < 1.0 else "arrivals"
    if getattr(study.config, key) not in (1.0, None):
        raise ConfigError(
            f"{where}: {key} = {getattr(study.config, key):g}: the scenario has a task "
            f"({scenario.task.type}), which is done or not; leave it out"
        )


def _build_conditions(config: FleetSizeConfig, base: Mapping[str, object]) -> list[Condition]:
    """Build the condition of each cell of the grid; the last axis changes fastest."""
    axes = [build_changes_axis(key, changes) for key, changes in config.axis.items()]
    if config.condition:
        named = {entry.name: entry.set for entry in config.condition}
        axes.insert(0, build_changes_axis("condition", named))
    conditions = []
    for cell in iterate_cells(axes):
        table = merge_tables(cell.edit(base), {"time": {"record_hz": 0.0}})
        name = cell.label or DEFAULT_CONDITION
        conditions.append(Condition(name=name, values=cell.names, table=table))
    return conditions


def _select_conditions(
    conditions: Sequence[Condition], only: Sequence[str], source: str
) -> tuple[Condition, ...]:
    names = [entry.name for entry in conditions]
    for name in only:
        if name not in names:
            raise ConfigError(
                f"--only {format_value(name)}: {format_path(source)} has no such condition; it has "
                + ", ".join(format_value(entry) for entry in names)
            )
    return tuple(entry for entry in conditions if not only or entry.name in only)


def _tuples_to_lists(value: object) -> object:
    """The same with lists for tuples: a checked file holds tuples."""
    if isinstance(value, Mapping):
        return {key: _tuples_to_lists(entry) for key, entry in value.items()}
    return (
        [_tuples_to_lists(entry) for entry in value] if isinstance(value, list | tuple) else value
    )
