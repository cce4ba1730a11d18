"""Scenario files: all settings of a run, checked before it begins."""

import hashlib
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, ClassVar, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from angler_mjx.errors import ConfigError
from angler_mjx.files import (
    FOLDER_CONTEXT,
    Fault,
    FaultyError,
    FileModel,
    JsonTable,
    dump_for_digest,
    format_faults,
    format_path,
    read_toml,
    rename_keys,
    validate_model,
)
from angler_mjx.planning.planner_choice import LARGE_TEAM
from angler_mjx.quantities import MAX_COORDINATE_M, SchemaVersion
from angler_mjx.robot.control.stack import StackGains, Stages
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.links import order_joints
from angler_mjx.robot.vehicles.load import Load
from angler_mjx.scenario import instrumented, table_checks
from angler_mjx.scenario.carry_table import CarryTask, fill_cargo_gains, find_cargo_load
from angler_mjx.scenario.contact_table import ContactConfig, check_bodies
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.load_table import check_load
from angler_mjx.scenario.path_resolution import resolve_paths
from angler_mjx.scenario.policy_tables import (
    PolicyConfig,
    check_end_effectors,
    check_policy,
    default_information,
)
from angler_mjx.scenario.randomise_table import RandomiseConfig
from angler_mjx.scenario.store_table import StoreConfig
from angler_mjx.scenario.tables import (
    BreakdownsConfig,
    ControllerConfig,
    ExecutionConfig,
    PlannerConfig,
    TimeConfig,
    WaterConfig,
    check_breakdowns,
    check_replanning,
)
from angler_mjx.scenario.task_table import (
    DeliverTask,
    GoalTask,
    TaskConfig,
    build_task_spec,
    check_task_policy,
)
from angler_mjx.shipped import find_shipped, list_shipped
from angler_mjx.sim.cargo import CargoSpec, GripNoise
from angler_mjx.sim.fleet import Member
from angler_mjx.sim.physics.step import Water
from angler_mjx.sim.state import SimSpec
from angler_mjx.world import presets
from angler_mjx.world.acoustics.channel import Channel
from angler_mjx.world.acoustics.config import AcousticsConfig
from angler_mjx.world.config import WorldConfig, resolve_world
from angler_mjx.world.currents import CurrentConfig, GridConfig
from angler_mjx.world.tasks.spec import TaskSpec

type Kernels = Literal["xla", "cuda"]
"""Compiler of an engine."""


class Scenario(FileModel):
    """A whole scenario file."""

    renamed_values: ClassVar[Mapping[str, Mapping[str, str]]] = {"kernels": {"triton": "cuda"}}

    schema_version: SchemaVersion = 1
    """Version of the file format."""
    name: str = Field(pattern=r"^[A-Za-z0-9_-]+$", max_length=100)
    """Name of the scenario; also of the run folder, unless the run names one."""
    description: str = ""
    """Free text for readers."""
    engine: Literal["mjx", "fused"] = "mjx"
    """Physics engine of the vehicles: MuJoCo's MJX, or the faster fused engine for rigid
    vehicles."""
    kernels: Kernels | None = None
    """Compiler of the engine; if left out, cuda for fused on a GPU, else xla. With xla, planners
    and tasks have no kernels either. Part of the result's bytes."""
    worlds: int = Field(default=256, ge=1, le=10**9)
    """Number of worlds, each with the whole fleet."""
    seed: int = Field(default=0, ge=0, lt=2**31)
    """Seed of all sampling; world i of a seed is the same in every run."""
    tile: int | None = Field(default=None, ge=1, le=10**7)
    """Worlds in one device call; device-dependent if left out. Part of the result's bytes."""
    goal_tolerance_m: float = Field(default=0.3, gt=0.0, le=MAX_COORDINATE_M)
    """Distance from its goal within which a robot has reached it."""
    time: TimeConfig = TimeConfig()
    water: WaterConfig = WaterConfig()
    world: WorldConfig
    # Every entry loads and checks its vehicle: 395 entries took a second to read.
    fleet: tuple[FleetEntry, ...] = Field(min_length=1, max_length=256)
    controller: ControllerConfig = ControllerConfig()
    planner: PlannerConfig = PlannerConfig()
    execution: ExecutionConfig = ExecutionConfig()
    policy: PolicyConfig = PolicyConfig()
    acoustics: AcousticsConfig = AcousticsConfig()
    store: StoreConfig = StoreConfig()
    randomise: RandomiseConfig = RandomiseConfig()
    task: TaskConfig = GoalTask()
    """Task of the robots of a world; see `docs/reference/tasks.md`."""
    breakdowns: BreakdownsConfig = BreakdownsConfig()
    contacts: bool = False
    """Whether bodies push each other, land and rest instead of ending an episode at the first
    touch; on the mjx engine. See `docs/reference/contact.md`."""
    contact: ContactConfig = ContactConfig()

    @model_validator(mode="after")
    def _set_horizon(self) -> Self:
        """Set the horizon of a file that gives none, before the checks that depend on it."""
        self.__dict__["time"] = self.time.with_default_horizon(
            presets.load_preset(self.world.preset).horizon_s
        )
        return self

    @model_validator(mode="after")
    def _set_carriers(self) -> Self:
        """Set starts and goals of robots that carry a body together."""
        if isinstance(self.task, CarryTask):
            if not self.contacts:
                raise ValueError(
                    'task.type = "carry": bodies must push each other; set contacts = true'
                )
            if self.task.hold == "end_effector":
                table_checks.check_gripping(self.controller, self.fleet)
                tips_m = table_checks.locate_tips(self.fleet)
            else:
                tips_m = np.zeros((sum(entry.count for entry in self.fleet), 3))
            self.__dict__["world"] = self.task.position_robots(self.world, tips_m)
        return self

    @model_validator(mode="after")
    def _set_planner(self) -> Self:
        """Replace auto by the planner of this team, or of its cargo."""
        robots = sum(entry.count for entry in self.fleet)
        carries = isinstance(self.task, CarryTask)
        self.__dict__["planner"] = self.planner.resolve_auto(robots, carries=carries)
        return self

    @model_validator(mode="after")
    def _set_policy(self) -> Self:
        """Set the policy of a task that plans alone do not do, where the file gives none."""
        if "name" in self.policy.model_fields_set:
            return self
        name = "none"
        if not isinstance(self.task, GoalTask | CarryTask):
            name = "routes"
        elif self.task.by_end_effector and not self.planner.plans_arms:
            name = "reach"
        if name != "none":
            self.__dict__["policy"] = self.policy.model_copy(update={"name": name})
        return self

    @model_validator(mode="after")
    def _set_order(self) -> Self:
        """Replace auto by the order of passing of this team."""
        keeps_order = (
            self.planner.by_auto
            and sum(entry.count for entry in self.fleet) >= LARGE_TEAM
            and self.water_or_obstacles_move
            and self.policy.name == "none"
            and self.planner.replan_hz == 0.0
            and self.acoustics.model == "perfect"
            and isinstance(self.task, GoalTask)
            and table_checks.takes_poses(self.controller)
        )
        self.__dict__["execution"] = self.execution.resolve_auto(kept=keeps_order)
        return self

    @model_validator(mode="after")
    def _set_policy_information(self) -> Self:
        """Set the information level of the policy, where the file gives none."""
        is_unset = self.policy.information is None
        if self.policy.name != "none" and (is_unset or self.policy.file is not None):
            information = default_information(self.policy, self.planner)
            policy = self.policy.model_copy(update={"information": information})
            if is_unset:
                policy.model_fields_set.discard("information")
            self.__dict__["policy"] = policy
        return self

    @model_validator(mode="after")
    def _check_kernels(self) -> Self:
        if self.engine == "mjx" and self.kernels not in (None, "xla"):
            raise ValueError(
                f'kernels = "{self.kernels}": the mjx engine has none; use engine = "fused"'
            )
        return self

    @model_validator(mode="after")
    def _check_tables(self) -> Self:
        table_checks.check_instruments(self.fleet, self.time)
        table_checks.check_currents(self.world, self.time)
        table_checks.check_fleet_fits(
            self.world, self.fleet, by_end_effector=self.by_end_effector, held=self.held_body
        )
        table_checks.check_arms_fit(self.world, self.fleet)
        table_checks.check_randomisation(self.randomise, self.fleet, self.world, self.water)
        table_checks.check_rotors(self.fleet)
        table_checks.check_links(self.engine, self.fleet)
        self._check_contact()
        table_checks.check_steering(self.controller, self.fleet)
        table_checks.check_fins(self.controller, self.fleet)
        table_checks.check_gliders(self.controller, self.fleet)
        table_checks.check_planar(self.world, self.fleet, contacts=self.contacts)
        table_checks.check_grips(
            self.controller,
            sum(entry.count for entry in self.fleet),
            carries=isinstance(self.task, CarryTask),
        )
        return self

    def _check_contact(self) -> None:
        if self.contacts and self.engine == "fused":
            raise ValueError(
                'contacts = true: engine = "fused" knows no contact; use engine = "mjx"'
            )
        if not self.contacts and self.contact != ContactConfig():
            key = min(self.contact.model_fields_set)
            raise ValueError(f"contact.{key}: there is no contact; set contacts = true")
        if self.contacts:
            check_bodies(self.world)

    @model_validator(mode="after")
    def _check_breakdowns(self) -> Self:
        check_breakdowns(self.breakdowns, self.time)
        return self

    @model_validator(mode="after")
    def _check_replanning(self) -> Self:
        check_replanning(self.planner, self.time)
        if self.online:
            table_checks.check_takes_poses(self.planner, self.execution, self.controller)
        return self

    @model_validator(mode="after")
    def _check_acoustics(self) -> Self:
        try:
            self.channel()
        except ValueError as error:
            raise ValueError(f"acoustics.{error}") from error
        table_checks.check_grip_record(self.store, carries=isinstance(self.task, CarryTask))
        table_checks.check_acoustics(self.acoustics, self.store, self.planner)
        return self

    @model_validator(mode="after")
    def _check_policy(self) -> Self:
        if self.policy.name == "none":
            return self
        if self.online:
            key = "planner.replan_hz" if self.planner.replan_hz else 'execution.order = "kept"'
            raise ValueError(
                f"policy.name = {self.policy.name!r}: {key} commands the robots already; leave out "
                "one of them"
            )
        check_policy(self.policy, self.time, self.controller, self.fleet)
        return self

    @model_validator(mode="after")
    def _check_task(self) -> Self:
        check_task_policy(self.task, self.policy, online=self.online)
        if self.by_end_effector:
            check_end_effectors(self.controller, self.fleet)
        self.task_spec()
        if load := self.carried():
            check_load(load, self.fleet)
        if share := self.cargo_load():
            check_load(share, self.fleet, "a robot's share of task.body")
        return self

    def carried(self) -> Load | None:
        """Return the load that a robot carries at a time; None where the task has no load."""
        if not isinstance(self.task, DeliverTask) or self.task.load is None:
            return None
        return self.task.load.load(self.water.density_kgpm3)

    def cargo_spec(self) -> CargoSpec | None:
        """Return what the fleet carries, and where to; None where it carries nothing together."""
        return self.task.cargo if isinstance(self.task, CarryTask) else None

    @property
    def grip_noise(self) -> GripNoise | None:
        """Return the errors of the force-torque sensors of grips; None where there are none."""
        return self.task.grip_noise if isinstance(self.task, CarryTask) else None

    def cargo_load(self) -> Load | None:
        """Return the part of each robot in a body that the fleet carries; None without one."""
        if not isinstance(self.task, CarryTask):
            return None
        return find_cargo_load(self.task, self.world, self.water.density_kgpm3)

    def _fill_cargo_gains(self, controllers: Stages, gains: StackGains) -> StackGains:
        """Return gains in which stages of carriers know the part of each robot in its load."""
        load = self.cargo_load()
        if load is None or not isinstance(self.task, CarryTask):
            return gains
        return fill_cargo_gains(
            self.task, self.world, load, controllers, gains, self.controller.gains
        )

    def task_spec(self) -> TaskSpec | None:
        """Return the compiled task; None where each robot has a goal of its own."""
        robots = sum(entry.count for entry in self.fleet)
        return build_task_spec(self.task, resolve_world(self.world), robots, self.time)

    @property
    def held_body(self) -> int:
        """Return the explicit obstacle that the robots hold by their arms; -1 for none."""
        if isinstance(self.task, CarryTask) and self.task.hold == "end_effector":
            return self.task.body
        return -1

    @property
    def by_end_effector(self) -> bool:
        """Return whether end effectors have to come to the goals."""
        return isinstance(self.task, GoalTask) and self.task.by_end_effector

    @property
    def flown(self) -> bool:
        """Return whether a policy or online execution of plans commands the robots."""
        return self.online or self.policy.name != "none"

    @property
    def online(self) -> bool:
        """Return whether plans are updated in flight."""
        return self.execution.order == "kept" or self.planner.replan_hz > 0.0

    @property
    def has_user_code(self) -> bool:
        """Return whether it names control laws or a policy of users' files."""
        return bool(self.controller.files) or self.policy.file is not None

    @property
    def keeps_order_by_auto(self) -> bool:
        """Return whether plans are updated only to keep the order of passing, and only by auto."""
        return self.execution.by_auto and self.execution.order == "kept"

    @property
    def obstacles_move(self) -> bool:
        """Return whether the worlds have moving obstacles."""
        obstacles = resolve_world(self.world).obstacles
        return obstacles.dynamic.count > 0 or any(
            obstacle.motion.type != "static" for obstacle in obstacles.explicit
        )

    @property
    def water_or_obstacles_move(self) -> bool:
        """Return whether the worlds have currents or moving obstacles."""
        return self.obstacles_move or bool(self.world.currents)

    @property
    def senses(self) -> bool:
        """Return whether the controllers of any robot use an estimate instead of the true state."""
        return any(not instrumented.uses_true_state(*entry.state_source()) for entry in self.fleet)

    def channel(self) -> Channel | None:
        """Return the acoustic channel between the robots; None where communication is perfect."""
        return self.acoustics.channel(
            sum(entry.count for entry in self.fleet),
            resolve_world(self.world).size_m,
            self.time.control_dt_s,
            self.time.horizon_s,
        )

    def members(self) -> list[Member]:
        """Return the fleet, one member a robot."""
        entry_members = [
            entry.build_member(i, self.randomise) for i, entry in enumerate(self.fleet)
        ]
        counts = [entry.count for entry in self.fleet]
        return [
            member
            for member, count in zip(entry_members, counts, strict=True)
            for _ in range(count)
        ]

    def joint_names(self) -> tuple[str, ...]:
        """Return the names of the joints of the fleet's arms, in the order of states."""
        for entry in self.fleet:
            if links := (config := library.load_vehicle(entry.vehicle)).find_links(None):
                return tuple(joint.name for joint in order_joints(links, config.joints))
        return ()

    def digest(self) -> str:
        """Return the hexadecimal digest of all settings that determine the problems of a seed.

        Scenarios that differ in other settings (engine, controllers, planner, recording) have the
        same problems.
        """
        world = dump_for_digest(self.world)
        world["currents"] = [_current_table(current) for current in self.world.currents]
        if self.world.bathymetry is None:  # keeps digests from before bathymetry existed
            del world["bathymetry"]
        problem_table = {
            "world": world,
            "fleet": self.fleet_tables(),
            "horizon_s": self.time.horizon_s,
            "control_dt_s": self.time.control_dt_s,
            "density_kgpm3": self.water.density_kgpm3,
            "goal_tolerance_m": self.goal_tolerance_m,
        }
        if not isinstance(self.task, GoalTask) or self.task.by_end_effector:
            problem_table["task"] = (
                self.task.problem_table()
                if isinstance(self.task, CarryTask)
                else dump_for_digest(self.task)
            )
        if self.randomise.changes_vehicles or self.randomise.changes_worlds:
            randomise = dump_for_digest(self.randomise)
            if not self.randomise.uncertainty:  # keeps digests from before it existed
                del randomise["uncertainty"]
            problem_table["randomise"] = randomise
        text = json.dumps(problem_table, sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()

    def fleet_tables(self) -> list[JsonTable]:
        """Return the entries of the fleet, with the current data of their vehicles' files."""
        return [_problem_table(entry) for entry in self.fleet]

    def sim_spec(self) -> SimSpec:
        """Return the simulator's settings."""
        controllers, gains = self.controller.stack()
        gains = self._fill_cargo_gains(controllers, gains)
        water = Water(density_kgpm3=self.water.density_kgpm3)
        grip = None
        if isinstance(self.task, CarryTask):
            grip = self.task.grip(self.contact.grip_friction())
        state_sources = [entry.state_source() for entry in self.fleet for _ in range(entry.count)]
        return SimSpec(
            physics_dt_s=self.time.physics_dt_s,
            physics_steps=self.time.physics_steps,
            goal_tolerance_m=self.goal_tolerance_m,
            by_end_effector=self.by_end_effector,
            water=water,
            stages=controllers,
            gains=gains,
            instrumented=instrumented.build_groups(
                state_sources, self.time.control_dt_s, water.gravity_mps2
            ),
            also=self.store.also,
            acoustics=self.channel(),
            task=self.task_spec(),
            contact=(
                self.contact.spec(self.time.physics_dt_s, self.world, grip)
                if self.contacts
                else None
            ),
            cargo=self.cargo_spec(),
            leader=self.controller.find_leader(),
        )


def _current_table(current: CurrentConfig) -> JsonTable:
    """Return the table of a current for a digest: with that of its file instead of the path."""
    table = dump_for_digest(current)
    return table | {"file": current.field.digest} if isinstance(current, GridConfig) else table


def _problem_table(entry: FleetEntry) -> JsonTable:
    """Return an entry of the fleet without flight-only keys, with its vehicle's current data."""
    table = entry.model_dump(mode="json", exclude={"estimate", "sensors", "fault_visible"})
    vehicle = library.load_vehicle(entry.vehicle)
    files: list[JsonTable] = [_vehicle_table(vehicle, entry.parameter_set_names())]
    if vehicle.rotor is not None:
        files.append(library.load_thruster(vehicle.rotor.model).model_dump(mode="json"))
    return {**table, "vehicle": files}


def _vehicle_table(vehicle: VehicleConfig, used_sets: Sequence[str]) -> JsonTable:
    """Return a vehicle file for digests, which stay those from before its newer tables.

    Left out are tables that it does not have, and sets with an uncertainty that are not used.
    """
    absent = () if vehicle.links else ("links", "joints", "end_effector")
    optional = ("fins", "planar", "ballast", "moving_masses")
    absent = (*absent, *(key for key in optional if not getattr(vehicle, key)))
    table: dict[str, Any] = vehicle.model_dump(mode="json", exclude={"parameter_sets", *absent})
    for row in table["thrusters"]["layout"]:
        if row["time_constant_s"] is None:
            del row["time_constant_s"]
        if row["curve"] is None:
            del row["curve"]
    table["parameter_sets"] = {
        name: row.model_dump(
            mode="json",
            exclude={
                **{key: True for key in ("links", "uncertainty") if not getattr(row, key)},
                **({} if row.damping.products else {"damping": {"products"}}),
                **({} if row.buoyancy.bodies else {"buoyancy": {"bodies"}}),
            },
        )
        for name, row in vehicle.parameter_sets.items()
        if name in used_sets or name in vehicle.published_sets
    }
    return table


def shipped_scenarios() -> dict[str, Path]:
    """Return the names and files of the shipped scenarios."""
    return list_shipped("angler_mjx.scenario")


def load_scenario(name_or_path: str | Path, **overrides: object) -> Scenario:
    """Read a scenario.

    Args:
        name_or_path: name of a shipped scenario, or path of a ``.toml`` file. Paths in the file
            begin at its folder.
        **overrides: top-level keys that replace those of the file, e.g. ``worlds=8``; a table is
            merged into the file's, e.g. ``time={"record_hz": 0.0}``. Paths in them begin at the
            working directory.

    Raises:
        ConfigError: there is no such scenario, its file has faults, or an override has faults (all
            are listed).
    """
    return read_scenario(name_or_path, overrides)


def load_relative_scenario(name: str, folder: Path) -> Scenario:
    """Read a scenario named in another file: a shipped one, or a path from that file's folder.

    Raises:
        ConfigError: as of `load_scenario`.
    """
    return load_scenario(name if name in shipped_scenarios() else folder / name)


def read_scenario(
    name_or_path: str | Path,
    overrides: Mapping[str, object],
    blame: Callable[[str], str] = lambda key: f"{key} (given with the scenario)",
) -> Scenario:
    """Read a scenario as `load_scenario` does; ``blame`` names an override, e.g. ``--worlds``."""
    path = find_scenario(name_or_path)
    try:
        data = rename_keys(Scenario, read_toml(path), str(path))
        overrides = rename_keys(Scenario, resolve_paths(overrides, Path.cwd()), "")
    except ValueError as error:
        raise ConfigError(f"{format_path(path)}: {error}") from error
    merged = {
        **data,
        **{key: _merge_value(data.get(key), value) for key, value in overrides.items()},
    }
    context = {FOLDER_CONTEXT: path.absolute().parent}
    try:
        scenario = validate_model(Scenario, merged, context)
    except FaultyError as error:
        file_faults = (
            _file_faults(data, context) if overrides else {fault.text for fault in error.faults}
        )
        file_texts = [fault.text for fault in error.faults if fault.text in file_faults]
        override_texts = [
            _attribute_fault(fault, overrides, blame)
            for fault in error.faults
            if fault.text not in file_faults
        ]
        file_message = [format_faults(str(path), file_texts)] if file_texts else []
        raise ConfigError("\n".join([*override_texts, *file_message])) from error
    try:
        scenario.planner.planner_spec()
    except ConfigError as error:
        raise ConfigError(str(error) if "planner" in overrides else f"{path}: {error}") from error
    return scenario


def _merge_value(before: object, value: object) -> object:
    if isinstance(value, dict) and isinstance(before, dict):
        return {**before, **value}
    return value


def _file_faults(data: Mapping[str, object], context: Mapping[str, object]) -> set[str]:
    """Return the faults of a file itself."""
    try:
        validate_model(Scenario, data, context)
    except FaultyError as error:
        return {fault.text for fault in error.faults}
    return set()


def _attribute_fault(
    fault: Fault, overrides: Mapping[str, object], blame: Callable[[str], str]
) -> str:
    """Return a fault of an override, with the override's name from ``blame``."""
    overridden: list[tuple[str, ...]] = []
    for key, value in overrides.items():
        overridden += [(key, name) for name in value] if isinstance(value, dict) else [(key,)]
    matching = [key for key in overridden if fault.key[: len(key)] == key]
    if matching:
        return fault.text.replace(".".join(matching[0]), blame(".".join(matching[0])), 1)
    text = fault.text
    if not fault.key:  # Of a whole file: the message names the keys.
        text = fault.text.removeprefix("(whole file): ")
        mentioned = [key for key in overridden if key[1:] and f"{'.'.join(key)} = " in text]
        if mentioned:
            return text.replace(".".join(mentioned[0]), blame(".".join(mentioned[0])), 1)
    candidates = [key for key in overridden if key[: len(fault.key)] == fault.key] or overridden
    return f"{', '.join(blame('.'.join(key)) for key in candidates)}: {text}"


def find_scenario(name_or_path: str | Path) -> Path:
    """Return the file of a scenario.

    Raises:
        ConfigError: there is no shipped scenario of that name, and it is no path of a ``.toml``
            file.
    """
    return find_shipped(name_or_path, "angler_mjx.scenario", "scenario")
