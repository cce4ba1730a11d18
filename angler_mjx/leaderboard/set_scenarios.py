"""Scenarios of sets as a planner or policy of the package flies them."""

from collections.abc import Mapping, Sequence
from types import MappingProxyType

from angler_mjx.errors import AnglerError, ConfigError
from angler_mjx.files import parse_model
from angler_mjx.leaderboard.submission import InFlightConfig
from angler_mjx.runs.simulator.world_preparation import check_planner
from angler_mjx.scenario.editing import scenario_table
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.information import LEVELS


def build_flown_scenario(scenario: Scenario, config: InFlightConfig, source: str) -> Scenario:
    """Return the scenario of a set as a planner or policy flies it.

    Its information is that of the set, or the lower level that it asks for.

    Raises:
        ConfigError: a key is unknown, or the planner cannot plan these problems.
    """
    levels = scenario.planner.information.model_dump()
    policy = dict(config.policy)
    if not config.has_policy:
        return build_planned_scenario(scenario, config.planner, source, dict(config.execution))
    policy["information"] = limit_information(levels, policy.get("information"))
    table = scenario_table(scenario)
    # A policy flies without a plan: its planner, if the card names none, must accept anything.
    nothing = dict.fromkeys(levels, "nothing")
    asked = config.planner.get("information") if config.planner else nothing
    planner = {
        **table["planner"],
        **config.planner,
        "information": limit_information(levels, asked),
    }
    flown = {**table, "planner": planner, "policy": policy, "execution": dict(config.execution)}
    return parse_model(Scenario, flown, source=f"{source} ({scenario.name})")


def build_planned_scenario(
    scenario: Scenario,
    planner: Mapping[str, object],
    source: str,
    execution: Mapping[str, object] = MappingProxyType({}),
) -> Scenario:
    """Return the scenario of a set with a planner, at the highest level that the planner can use.

    Args:
        scenario: of the set.
        planner: keys of a scenario's ``planner``.
        source: of them, for messages.
        execution: keys of a scenario's ``execution``.

    Raises:
        ConfigError: a key is unknown, or it cannot plan these problems at any level.
    """
    levels = scenario.planner.information.model_dump()
    asked = planner.get("information")
    wanted: Sequence[Mapping[str, str] | None] = (
        [asked] if isinstance(asked, Mapping) else [None, {**levels, "current": "nothing"}]
    )
    refusal: AnglerError | None = None
    for level in wanted:
        table = scenario_table(scenario)
        table["planner"] = {
            **table["planner"],
            **planner,
            "information": limit_information(levels, level),
        }
        table["execution"] = {**table.get("execution", {}), **execution}
        changed = parse_model(Scenario, table, source=f"{source} ({scenario.name})")
        try:
            check_planner(changed)
        except ConfigError as error:
            refusal = error
            continue
        return changed
    raise ConfigError(f"{scenario.name}: {refusal}")


def limit_information(
    levels: Mapping[str, str], wanted: Mapping[str, str] | None
) -> dict[str, str]:
    """Return the lower one of the set's level and of what is asked for, of each part."""
    return {
        part: min(level, (wanted or levels).get(part, "nothing"), key=LEVELS.index)
        for part, level in levels.items()
    }
