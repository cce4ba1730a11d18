"""Those that are compared: planners, flown as they planned or online, and policies."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Protocol

from angler_mjx.errors import ConfigError, format_value
from angler_mjx.files import parse_model
from angler_mjx.planning import register
from angler_mjx.planning.register import PlannerSpec
from angler_mjx.runs.simulator import scenario_policy
from angler_mjx.runs.storage.checksums import hash_file
from angler_mjx.scenario.editing import merge_tables, scenario_table
from angler_mjx.scenario.policy_of_file import is_policy_class
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.scenario.tables import PlannerConfig
from angler_mjx.sim.information import Information
from angler_mjx.studies.benchmark.config import PlannerEntry
from angler_mjx.user_classes import is_class_of_file


@dataclass(frozen=True, kw_only=True)
class ComparedPlanner:
    """One that is compared with others."""

    label: str
    spec: PlannerSpec | None
    """That plans before the start; None of a policy, which flies without plans."""
    information: Information | None
    """What it is told; that of the problems if None."""
    joints: bool
    """Whether its paths are trajectories of joints."""
    on_device: bool
    """Whether it plans a batch at once."""
    policy: str | None = None
    """By its name in a scenario, where it is one."""
    policy_settings: Mapping[str, object] = field(default_factory=dict)
    """That differ from the scenario's."""
    online: Mapping[str, object] = field(default_factory=dict)
    """How its plans are looked after in flight, by the keys of a benchmark file; empty where they
    are flown as they are."""

    presets: tuple[str, ...] = ()
    """Whose problems it is asked; all if empty."""
    teams: tuple[int, ...] = ()
    """Robots in the problems that it is asked; any if empty."""

    @property
    def name(self) -> str:
        """Of its planner, or its policy."""
        return self.policy or self.planner.reference.name

    @property
    def planner(self) -> PlannerSpec:
        """That plans before the start.

        Raises:
            RuntimeError: it is a policy.
        """
        if self.spec is None:
            raise RuntimeError(f"policy {self.policy} has no planner")
        return self.spec

    @property
    def settings(self) -> dict[str, object]:
        """Its own."""
        return dict(self.policy_settings if self.spec is None else self.spec.settings)

    @property
    def sha256(self) -> str | None:
        """Of the file that its class is in."""
        if self.spec is not None:
            return self.spec.reference.sha256
        return None if self.file is None else hash_file(self.file)

    @property
    def file(self) -> Path | None:
        """That its class is in."""
        if self.spec is not None:
            return self.spec.reference.file
        path, _, _ = self.name.rpartition(":")
        return Path(path) if is_class_of_file(self.name) else None

    @property
    def flies_itself(self) -> bool:
        """Whether robots are flown otherwise than along the plans of the start alone."""
        return self.policy is not None or bool(self.online)

    def spec_of(self, scenario: Scenario) -> PlannerSpec:
        """What a worker makes its planner of, for the problems of a scenario."""
        return replace(self.planner, max_points=scenario.planner.points)


def build_compared_planner(entry: PlannerEntry) -> ComparedPlanner:
    """What an entry of a file names.

    Raises:
        ConfigError: there is no such planner, or it has no such settings.
        UnsupportedError: its libraries are not installed.
    """
    information = None if entry.information is None else entry.information.to_information()
    if entry.policy is not None:
        return ComparedPlanner(
            label=entry.title,
            spec=None,
            information=information,
            joints=False,
            on_device=False,
            policy=entry.policy,
            policy_settings=entry.settings,
            presets=entry.presets,
            teams=entry.teams,
        )
    if is_class_of_file(entry.name) and is_policy_class(entry.name):
        name = format_value(entry.name)
        raise ConfigError(f"planner.name = {name}: is a policy; give policy = {name} instead")
    table = {entry.name.rpartition(":")[2]: entry.settings} if entry.settings else {}
    spec = PlannerConfig(name=entry.name, settings=table).planner_spec()
    if register.plans_arms(spec):
        raise ConfigError(
            f"planner {format_value(entry.title)}: arm = true; benchmarks store paths of bases "
            "alone: leave arm out, or fly the scenario with angler rollout"
        )
    return ComparedPlanner(
        label=entry.title,
        spec=spec,
        information=information,
        joints=register.plans_joints(spec),
        on_device=spec.reference.on_device,
        online=entry.online,
        presets=entry.presets,
        teams=entry.teams,
    )


class Pilot(Protocol):
    """Planner or policy that robots fly by, as a file names it."""

    @property
    def policy(self) -> str | None:
        """Name of the policy; None of a planner."""
        ...

    @property
    def name(self) -> str:
        """Name of the planner."""
        ...

    @property
    def settings(self) -> Mapping[str, object]:
        """Settings of the planner or policy."""
        ...

    @property
    def online(self) -> Mapping[str, object]:
        """Keys of replanning in flight, and of the order of robots."""
        ...


def build_pilot_tables(
    pilot: Pilot, information: Mapping[str, object] | None
) -> dict[str, dict[str, object]]:
    """Return the scenario tables by which robots fly, without keys of other planners.

    Args:
        pilot: planner or policy.
        information: table of its information level; left out if None.
    """
    level = {} if information is None else {"information": dict(information)}
    name = pilot.name if pilot.policy is None else pilot.policy
    settings = {name.rpartition(":")[2]: dict(pilot.settings)} if pilot.settings else {}
    if pilot.policy is not None:
        return {"policy": {"name": name, **level, **settings}}
    online = {key: value for key, value in pilot.online.items() if key != "order"}
    order = pilot.online.get("order")
    planner = {"name": name, **level, **online, "settings": settings}
    return {"planner": planner, **({"execution": {"order": order}} if order else {})}


def build_flown_scenario(
    scenario: Scenario, information: Information, planner: ComparedPlanner, about: str
) -> Scenario:
    """The scenario by which the robots of a contestant fly.

    Args:
        scenario: of the problems.
        information: what may be known of them.
        planner: whose flight.
        about: the file and the problems, for messages.

    Raises:
        ConfigError: it cannot be flown so: what the scenario's own tables refuse is refused here.
    """
    if not planner.flies_itself:
        return scenario
    level = {"obstacles": information.obstacles, "current": information.current}
    table = merge_tables(scenario_table(scenario), build_pilot_tables(planner, level))
    source = f"{about}, planner {format_value(planner.label)}"
    flown_scenario = parse_model(Scenario, table, source=source)
    try:
        scenario_policy.resolve_policy(flown_scenario, None)
    except ConfigError as error:
        raise ConfigError(f"{source}: {error}") from error
    if planner.joints and flown_scenario.planner.replan_hz:
        raise ConfigError(
            f"{source}: planner.replan_hz = {flown_scenario.planner.replan_hz:g}: planner "
            f"{planner.name} gives "
            "trajectories of joints, and plans are made anew as way-points; leave out replan_hz"
        )
    return flown_scenario
