"""Scenario files: everything that a run needs to know, checked before anything is computed."""

import hashlib
import json
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Literal, Self

from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import FOLDER, Fault, FaultyError, FileModel, check, listed, read_toml
from angler_mjx.planning.automatic import LARGE_TEAM
from angler_mjx.quantities import FARTHEST_M, SchemaVersion
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.load import Load
from angler_mjx.scenario import fits, instrumented
from angler_mjx.scenario.breakdowns_table import BreakdownsConfig, check_breakdowns
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.load_table import check_load
from angler_mjx.scenario.paths import anchored
from angler_mjx.scenario.policy_tables import PolicyConfig, check_flyable, default_knows
from angler_mjx.scenario.randomise_table import RandomiseConfig
from angler_mjx.scenario.store_table import StoreConfig
from angler_mjx.scenario.tables import (
    ControllerConfig,
    ExecutionConfig,
    PlannerConfig,
    TimeConfig,
    WaterConfig,
    check_online,
)
from angler_mjx.scenario.task_table import (
    DeliverTask,
    GoalTask,
    TaskConfig,
    check_flown,
    spec_of,
)
from angler_mjx.shipped import find_shipped, list_shipped
from angler_mjx.sim.fleet import Member
from angler_mjx.sim.physics.step import Water
from angler_mjx.sim.state import SimSpec
from angler_mjx.world import presets
from angler_mjx.world.acoustics.channel import Channel
from angler_mjx.world.acoustics.config import AcousticsConfig
from angler_mjx.world.config import WorldConfig, resolve
from angler_mjx.world.currents import GridConfig
from angler_mjx.world.tasks.spec import TaskSpec


class Scenario(FileModel):
    """A whole scenario file."""

    schema_version: SchemaVersion = 1
    """Of this form of files."""
    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)
    """Of the run folder, if the run is given none."""
    description: str = ""
    """For people."""
    engine: Literal["mjx", "fused"] = "mjx"
    """What moves the vehicles: MuJoCo's MJX, or our own faster one for rigid vehicles."""
    kernels: Literal["xla", "triton"] | None = None
    """What the engine is compiled by; for fused on a GPU triton if left out, else xla. Part of the
    result's bytes."""
    worlds: int = Field(default=256, ge=1, le=10**9)
    """Number of worlds, each with the whole fleet."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    """Of everything that is drawn; world i of a seed is the same in every run."""
    tile: int | None = Field(default=None, ge=1, le=10**7)
    """Worlds in one device call; chosen for the device if left out. Part of the result's bytes."""
    goal_tolerance_m: float = Field(default=0.3, gt=0.0, le=FARTHEST_M)
    """A robot has reached its goal within this distance."""
    time: TimeConfig = TimeConfig()
    water: WaterConfig = WaterConfig()
    world: WorldConfig
    # Each entry's vehicle is looked through: 395 of them took a second to read.
    fleet: tuple[FleetEntry, ...] = Field(min_length=1, max_length=256)
    controller: ControllerConfig = ControllerConfig()
    planner: PlannerConfig = PlannerConfig()
    execution: ExecutionConfig = ExecutionConfig()
    policy: PolicyConfig = PolicyConfig()
    acoustics: AcousticsConfig = AcousticsConfig()
    store: StoreConfig = StoreConfig()
    randomise: RandomiseConfig = RandomiseConfig()
    task: TaskConfig = GoalTask()
    """What the robots of a world have to do; see `docs/tasks.md`."""
    breakdowns: BreakdownsConfig = BreakdownsConfig()

    @model_validator(mode="after")
    def _horizon_of_preset(self) -> Self:
        """The horizon of a file that gives none; before the checks of what fits it."""
        self.__dict__["time"] = self.time.by_default(presets.load(self.world.preset).horizon_s)
        return self

    @model_validator(mode="after")
    def _planner_of_team(self) -> Self:
        """Put the planner of this team in place of auto."""
        self.__dict__["planner"] = self.planner.resolved(sum(entry.count for entry in self.fleet))
        return self

    @model_validator(mode="after")
    def _policy_of_task(self) -> Self:
        """Who flies from place to place, where the file does not say."""
        if not isinstance(self.task, GoalTask) and "name" not in self.policy.model_fields_set:
            self.__dict__["policy"] = self.policy.model_copy(update={"name": "routes"})
        return self

    @model_validator(mode="after")
    def _order_of_team(self) -> Self:
        """Put the order that this team's plans are flown in in place of auto."""
        kept = (
            self.planner.by_auto
            and sum(entry.count for entry in self.fleet) >= LARGE_TEAM
            and self.water_or_obstacles_move
            and self.policy.name == "none"
            and self.planner.replan_hz == 0.0
            and self.acoustics.model == "perfect"
            and isinstance(self.task, GoalTask)
            and fits.takes_poses(self.controller)
        )
        self.__dict__["execution"] = self.execution.resolved(kept=kept)
        return self

    @model_validator(mode="after")
    def _information_of_policy(self) -> Self:
        """Set the information level of the policy, where the file gives none to it."""
        if self.policy.name != "none" and self.policy.knows is None:
            knows = default_knows(self.policy, self.planner)
            policy = self.policy.model_copy(update={"knows": knows})
            policy.model_fields_set.discard("knows")
            self.__dict__["policy"] = policy
        return self

    @model_validator(mode="after")
    def _kernels_of_engine(self) -> Self:
        if self.engine == "mjx" and self.kernels == "triton":
            raise ValueError('kernels = "triton": the mjx engine has none; use engine = "fused"')
        return self

    @model_validator(mode="after")
    def _tables_fit(self) -> Self:
        fits.check_instruments(self.fleet, self.time)
        fits.check_currents(self.world, self.time)
        fits.check_room(self.world, self.fleet)
        fits.check_randomised(self.randomise, self.fleet, self.world, self.water)
        fits.check_rotors(self.fleet)
        fits.check_steering(self.controller, self.fleet)
        return self

    @model_validator(mode="after")
    def _breaks_down_in_time(self) -> Self:
        check_breakdowns(self.breakdowns, self.time)
        return self

    @model_validator(mode="after")
    def _flies_online(self) -> Self:
        check_online(self.planner, self.time)
        if self.online:
            fits.check_guided(self.planner, self.execution, self.controller)
        return self

    @model_validator(mode="after")
    def _talks(self) -> Self:
        try:
            self.channel()
        except ValueError as error:
            raise ValueError(f"acoustics.{error}") from error
        fits.check_heard(self.acoustics, self.store, self.planner)
        return self

    @model_validator(mode="after")
    def _flies_by_policy(self) -> Self:
        if self.policy.name == "none":
            return self
        if self.online:
            key = "planner.replan_hz" if self.planner.replan_hz else 'execution.order = "kept"'
            raise ValueError(
                f"policy.name = {self.policy.name!r}: {key} commands the robots already; leave out "
                "one of them"
            )
        check_flyable(self.policy, self.time, self.controller, self.fleet)
        return self

    @model_validator(mode="after")
    def _task_can_be_done(self) -> Self:
        check_flown(self.task, self.policy, online=self.online)
        self.task_spec()
        if load := self.carried():
            check_load(load, self.fleet)
        return self

    def carried(self) -> Load | None:
        """What each robot carries at a time; None where the task has nothing that weighs."""
        if not isinstance(self.task, DeliverTask) or self.task.load is None:
            return None
        return self.task.load.load(self.water.density_kgpm3)

    def task_spec(self) -> TaskSpec | None:
        """What the task is compiled from; None where each robot has a goal of its own."""
        robots = sum(entry.count for entry in self.fleet)
        return spec_of(self.task, resolve(self.world), robots, self.time)

    @property
    def flown(self) -> bool:
        """Whether a policy that the scenario names commands the robots, or looks after plans."""
        return self.online or self.policy.name != "none"

    @property
    def online(self) -> bool:
        """Whether plans are looked after while they are flown."""
        return self.execution.order == "kept" or self.planner.replan_hz > 0.0

    @property
    def keeps_order_by_auto(self) -> bool:
        """Whether plans are looked after for the order of passing alone, which nobody requested."""
        return self.execution.by_auto and self.execution.order == "kept"

    @property
    def obstacles_move(self) -> bool:
        """Whether the worlds have obstacles that move."""
        obstacles = resolve(self.world).obstacles
        return obstacles.dynamic.count > 0 or any(
            one.motion.type != "static" for one in obstacles.explicit
        )

    @property
    def water_or_obstacles_move(self) -> bool:
        """Whether the worlds have currents or obstacles that move."""
        return self.obstacles_move or bool(self.world.currents)

    @property
    def senses(self) -> bool:
        """Whether the controllers of any robot are told something other than the truth."""
        return any(not instrumented.told_truth(*entry.told()) for entry in self.fleet)

    def channel(self) -> Channel | None:
        """That robots talk by; None where everybody knows everything."""
        return self.acoustics.channel(
            sum(entry.count for entry in self.fleet),
            resolve(self.world).size_m,
            self.time.control_dt_s,
            self.time.horizon_s,
        )

    def members(self) -> list[Member]:
        """The fleet, one member a robot."""
        each = [entry.member(i, self.randomise) for i, entry in enumerate(self.fleet)]
        counts = [entry.count for entry in self.fleet]
        return [member for member, count in zip(each, counts, strict=True) for _ in range(count)]

    def digest(self) -> str:
        """Hexadecimal, of everything that the problems of a seed are drawn from.

        Scenarios that differ in other things (engine, controllers, planner, recording) pose the
        same problems.
        """
        world = self.world.model_dump(mode="json")
        for table, current in zip(world["currents"], self.world.currents, strict=True):
            if isinstance(current, GridConfig):
                table["file"] = current.field.digest
        if self.world.bathymetry is None:  # as before there were any: problems stay what they were
            del world["bathymetry"]
        drawn = {
            "world": world,
            "fleet": [_as_drawn(entry) for entry in self.fleet],
            "horizon_s": self.time.horizon_s,
            "control_dt_s": self.time.control_dt_s,
            "density_kgpm3": self.water.density_kgpm3,
            "goal_tolerance_m": self.goal_tolerance_m,
        }
        if not isinstance(self.task, GoalTask):
            drawn["task"] = self.task.model_dump(mode="json")
        if self.randomise.of_vehicles or self.randomise.of_worlds:
            drawn["randomise"] = self.randomise.model_dump(mode="json")
        text = json.dumps(drawn, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def sim_spec(self) -> SimSpec:
        """The simulator's settings."""
        controllers, gains = self.controller.stack()
        water = Water(density_kgpm3=self.water.density_kgpm3)
        told = [entry.told() for entry in self.fleet for _ in range(entry.count)]
        return SimSpec(
            physics_dt_s=self.time.physics_dt_s,
            physics_steps=self.time.physics_steps,
            goal_tolerance_m=self.goal_tolerance_m,
            water=water,
            stages=controllers,
            gains=gains,
            instrumented=instrumented.build(told, self.time.control_dt_s, water.gravity_mps2),
            also=self.store.also,
            acoustics=self.channel(),
            task=self.task_spec(),
        )


def _as_drawn(entry: FleetEntry) -> dict[str, Any]:
    """An entry of the fleet without what only its flight shows; its vehicle as it is now."""
    table = entry.model_dump(mode="json", exclude={"estimate", "sensors", "fault_known"})
    vehicle = library.load(entry.vehicle)
    thruster = library.load_thruster(vehicle.rotor.model)
    return {**table, "vehicle": [vehicle.model_dump(mode="json"), thruster.model_dump(mode="json")]}


def shipped() -> dict[str, Path]:
    """Names and files of the scenarios that come with the package."""
    return list_shipped("angler_mjx.scenario")


def load_scenario(name_or_path: str | Path, **overrides: Any) -> Scenario:
    """Read a scenario.

    Args:
        name_or_path: name of a shipped scenario, or path of a ``.toml`` file. Paths in the file
            begin at its folder.
        **overrides: top-level keys that replace those of the file, e.g. ``worlds=8``; a table is
            merged into the file's, e.g. ``time={"record_hz": 0.0}``. Paths in them begin at the
            working directory.

    Raises:
        ConfigError: there is no such scenario, its file has faults, or an override has (all are
            listed).
    """
    return read_scenario(name_or_path, overrides)


def load_beside(name: str, folder: Path) -> Scenario:
    """The scenario that another file names: a shipped one, or a path from that file's folder.

    Raises:
        ConfigError: as of `load_scenario`.
    """
    return load_scenario(name if name in shipped() else folder / name)


def read_scenario(
    name_or_path: str | Path,
    overrides: Mapping[str, Any],
    blame: Callable[[str], str] = lambda key: f"{key} (given with the scenario)",
) -> Scenario:
    """As `load_scenario`; ``blame`` says what a person calls an override, e.g. ``--worlds``."""
    path = find(name_or_path)
    data = read_toml(path)
    overrides = anchored(overrides, Path.cwd())
    whole = {**data, **{key: _merged(data.get(key), x) for key, x in overrides.items()}}
    beside = {FOLDER: path.absolute().parent}
    try:
        found = check(Scenario, whole, beside)
    except FaultyError as error:
        own = _faults(data, beside) if overrides else {fault.text for fault in error.faults}
        its = [fault.text for fault in error.faults if fault.text in own]
        theirs = [
            _blamed(fault, overrides, blame) for fault in error.faults if fault.text not in own
        ]
        of_file = [listed(str(path), its)] if its else []
        raise ConfigError("\n".join([*theirs, *of_file])) from error
    try:
        found.planner.chosen()
    except ConfigError as error:
        raise ConfigError(str(error) if "planner" in overrides else f"{path}: {error}") from error
    return found


def _merged(before: Any, value: Any) -> Any:
    both = isinstance(value, dict) and isinstance(before, dict)
    return {**before, **value} if both else value


def _faults(data: Mapping[str, Any], context: Mapping[str, Any]) -> set[str]:
    """What is wrong with a file itself."""
    try:
        check(Scenario, data, context)
    except FaultyError as error:
        return {fault.text for fault in error.faults}
    return set()


def _blamed(fault: Fault, overrides: Mapping[str, Any], blame: Callable[[str], str]) -> str:
    """A fault that an override brought, by what a person calls that override."""
    given: list[tuple[str, ...]] = []
    for key, value in overrides.items():
        given += [(key, name) for name in value] if isinstance(value, dict) else [(key,)]
    exact = [key for key in given if fault.key[: len(key)] == key]
    if exact:
        return fault.text.replace(".".join(exact[0]), blame(".".join(exact[0])), 1)
    text = fault.text
    if not fault.key:  # Of a whole file: the message says which keys.
        text = fault.text.removeprefix("(whole file): ")
        said = [key for key in given if key[1:] and f"{'.'.join(key)} = " in text]
        if said:
            return text.replace(".".join(said[0]), blame(".".join(said[0])), 1)
    near = [key for key in given if key[: len(fault.key)] == fault.key] or given
    return f"{', '.join(blame('.'.join(key)) for key in near)}: {text}"


def find(name_or_path: str | Path) -> Path:
    """The file of a scenario.

    Raises:
        ConfigError: there is no shipped one of that name, and it is no path of a ``.toml`` file.
    """
    return find_shipped(name_or_path, "angler_mjx.scenario", "scenario")
