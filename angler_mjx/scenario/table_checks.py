"""Checks between tables of a scenario: functions that raise ValueError, naming the keys."""

from collections.abc import Sequence

import jax
import numpy as np

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.commands import PoseTarget
from angler_mjx.robot.control.laws.cargo_part import CargoPartGains
from angler_mjx.robot.sensing import params as instruments
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.link_hull import max_link_reach_m
from angler_mjx.robot.vehicles.link_motion import locate_end_effector
from angler_mjx.robot.vehicles.link_params import build_links, build_tree
from angler_mjx.scenario import instrumented
from angler_mjx.scenario.fleet_entry import FleetEntry
from angler_mjx.scenario.randomise_table import UNCHANGED, RandomiseConfig
from angler_mjx.scenario.store_table import StoreConfig
from angler_mjx.scenario.tables import (
    ControllerConfig,
    ExecutionConfig,
    PlannerConfig,
    TimeConfig,
    WaterConfig,
)
from angler_mjx.world.acoustics.config import AcousticsConfig
from angler_mjx.world.config import WorldConfig, resolve_world
from angler_mjx.world.currents import GaussMarkovConfig, GridConfig
from angler_mjx.world.generate import check_fleet

MAX_KNOTS = 100_000
"""Max number of knots of a current over a run; each world holds them in memory."""


def check_instruments(fleet: Sequence[FleetEntry], time: TimeConfig) -> None:
    """Refuse instruments that cannot measure at the control steps."""
    for i, entry in enumerate(fleet):
        try:
            instruments.check_sensors(entry.state_source()[1], time.control_dt_s)
        except ConfigError as error:
            raise ValueError(f"fleet.{i}.{error}") from error


def check_currents(world: WorldConfig, time: TimeConfig) -> None:
    """Refuse currents that do not cover the run, or need too many knots for it."""
    for i, current in enumerate(world.currents):
        if isinstance(current, GridConfig):
            try:
                current.starts_s(time.horizon_s)
            except ValueError as error:
                raise ValueError(f"world.currents[{i}].{error}") from error
        if not isinstance(current, GaussMarkovConfig):
            continue
        knots = time.horizon_s / current.knot_dt_s
        if knots > MAX_KNOTS:
            raise ValueError(
                f"world.currents[{i}].knot_dt_s = {current.knot_dt_s:g}: {knots:.0f} knots in "
                f"{time.horizon_s:g} s; {MAX_KNOTS} are the most: take a longer knot_dt_s"
            )


def check_fleet_fits(
    world: WorldConfig, fleet: Sequence[FleetEntry], *, by_end_effector: bool, held: int
) -> None:
    """Refuse worlds that cannot hold the fleet."""
    reach_m = [library.reach_m(library.load_vehicle(entry.vehicle)) for entry in fleet]
    counts = [entry.count for entry in fleet]
    try:
        check_fleet(
            resolve_world(world),
            np.repeat(reach_m, counts),
            by_end_effector=by_end_effector,
            held=held,
        )
    except ConfigError as error:
        raise ValueError(f"world, for the fleet: {error}") from error


def check_arms_fit(world: WorldConfig, fleet: Sequence[FleetEntry]) -> None:
    """Refuse cells that are smaller than an arm: contact is looked for one cell around."""
    cell_m = resolve_world(world).cell_m
    for i, entry in enumerate(fleet):
        arm_m = max_link_reach_m(library.load_vehicle(entry.vehicle))
        if arm_m >= cell_m:
            raise ValueError(
                f"world.cell_m = {cell_m:g}: the arm of fleet[{i}], vehicle {entry.vehicle!r}, "
                f"reaches {arm_m:.3g} m from its centre of mass; take larger cells"
            )


def check_randomisation(
    randomise: RandomiseConfig, fleet: Sequence[FleetEntry], world: WorldConfig, water: WaterConfig
) -> None:
    """Refuse ranges without effect, and vehicles that the ranges make impossible."""
    if randomise.sensor_noise != UNCHANGED and all(
        instrumented.uses_true_state(*entry.state_source()) for entry in fleet
    ):
        raise ValueError(
            "randomise.sensor_noise: all robots use their true state; give one of [[fleet]] "
            'estimate = "noisy" or "ekf"'
        )
    if randomise.current != UNCHANGED and not world.currents:
        raise ValueError("randomise.current: there is no current; add [[world.currents]]")
    for i, entry in enumerate(fleet if randomise.changes_vehicles else ()):
        try:
            randomise.check(
                library.load_vehicle(entry.vehicle),
                entry.parameter_set_names(),
                entry.battery_v,
                water.density_kgpm3,
            )
        except ConfigError as error:
            raise ValueError(f"fleet[{i}]: {error}") from error


def check_rotors(fleet: Sequence[FleetEntry]) -> None:
    """Refuse first- and third-order rotors together: their states have different shapes."""
    first = None
    for i, entry in enumerate(fleet):
        config = library.load_vehicle(entry.vehicle)
        is_third_order = config.find_response(entry.rotor_response) == "third_order"
        response = config.rotor.third_order if is_third_order and config.rotor else None
        coefficients = response and (response.numerator, response.denominator)
        first = first or (coefficients,)
        if coefficients != first[0]:
            raise ValueError(
                f"fleet[{i}]: the rotors of {config.name!r} answer otherwise than those of "
                "fleet[0]; give all robots of a fleet the same rotor_response"
            )


def check_links(engine: str, fleet: Sequence[FleetEntry]) -> None:
    """Refuse joints on the fused engine, and vehicles of one fleet with different arms."""
    armed = [
        (i, config, build_tree(config))
        for i, entry in enumerate(fleet)
        if (config := library.load_vehicle(entry.vehicle)).links
    ]
    for i, config, tree in armed:
        if engine == "fused":
            raise ValueError(
                f'fleet[{i}]: vehicle {config.name!r} has joints; engine = "fused" flies '
                'rigid vehicles only, use engine = "mjx"'
            )
        if tree != armed[0][2]:
            first = armed[0]
            raise ValueError(
                f"fleet[{i}]: the links of {config.name!r} hang together otherwise than those of "
                f"fleet[{first[0]}], vehicle {first[1].name!r}; fly them in runs of their own"
            )


def check_steering(controller: ControllerConfig, fleet: Sequence[FleetEntry]) -> None:
    """Refuse controllers with sway commands where a vehicle has no sway."""
    sideways = [stage.name for stage in controller.stack()[0] if stage.wants_sway]
    for i, entry in enumerate(fleet if sideways else ()):
        if any("sway" in drive.missing_axes for drive in entry.drive_limits()):
            raise ValueError(
                f"controller: stage {sideways[0]!r} pushes to the side, and fleet[{i}], "
                f"vehicle {library.load_vehicle(entry.vehicle).name!r}, has no sway; take another "
                "controller, such as cascade or los"
            )


def check_planar(world: WorldConfig, fleet: Sequence[FleetEntry], *, contacts: bool) -> None:
    """Refuse worlds in which vehicles that are held level would have to climb, and contact."""
    for i, entry in enumerate(fleet):
        config = library.load_vehicle(entry.vehicle)
        if not config.planar:
            continue
        height = resolve_world(world).shape[2]
        if height != 1:
            raise ValueError(
                f"world.shape: fleet[{i}], vehicle {config.name!r}, moves in the plane of the "
                f"surface, and the water is {height} cells high; give shape = [x, y, 1]"
            )
        if contacts:
            raise ValueError(
                f"contacts = true: fleet[{i}], vehicle {config.name!r}, is held level, and contact "
                "would lift it; leave contacts out"
            )


def check_fins(controller: ControllerConfig, fleet: Sequence[FleetEntry]) -> None:
    """Refuse controllers that hover where a vehicle flies by its fins."""
    if any(stage.flies_by_fins for stage in controller.stack()[0]):
        return
    for i, entry in enumerate(fleet):
        if any(drive.flies_by_fins for drive in entry.drive_limits()):
            raise ValueError(
                f"controller: {controller.title!r} steers by thrust, and fleet[{i}], vehicle "
                f"{library.load_vehicle(entry.vehicle).name!r}, turns and dives by its fins, with "
                'way on; take controller.name = "los"'
            )


def check_gliders(controller: ControllerConfig, fleet: Sequence[FleetEntry]) -> None:
    """Refuse controllers with thrust for gliders, and those of gliders for other vehicles."""
    can_glide = any(stage.glides for stage in controller.stack()[0])
    for i, entry in enumerate(fleet):
        is_glider = all(drive.glides for drive in entry.drive_limits())
        name = library.load_vehicle(entry.vehicle).name
        if is_glider and not can_glide:
            raise ValueError(
                f"controller: {controller.title!r} needs thrust, and fleet[{i}], vehicle {name!r}, "
                'has none: it glides by ballast and moving masses; take controller.name = "glide"'
            )
        if can_glide and not is_glider:
            raise ValueError(
                f"controller: {controller.title!r} flies vehicles without thrust, by ballast and "
                f"moving masses, and fleet[{i}], vehicle {name!r}, is none of these; take another "
                "controller, such as cascade or los"
            )


def check_grips(controller: ControllerConfig, robots: int, *, carries: bool) -> None:
    """Refuse controllers that measure the force of a grip where no robot holds anything.

    Args:
        controller: of all robots.
        robots: number of robots of a world.
        carries: whether they hold a body.

    Raises:
        ValueError: naming the stage, or a leader that is not there.
    """
    measuring = [stage.name for stage in controller.stack()[0] if stage.wants_grip]
    if measuring and not carries:
        raise ValueError(
            f"controller.stages: {measuring[0]!r} takes the measured force of a grip, and no robot "
            'holds anything; give task.type = "carry", or leave it out'
        )
    leader = controller.find_leader()
    if leader is not None and leader >= robots:
        raise ValueError(f"controller.leader = {leader}: the fleet has {robots} robots")


def check_gripping(controller: ControllerConfig, fleet: Sequence[FleetEntry]) -> None:
    """Refuse fleets that cannot hold a body by end effectors, and laws that know no such lever.

    Raises:
        ValueError: naming the key and its value.
    """
    for i, entry in enumerate(fleet):
        config = library.load_vehicle(entry.vehicle)
        if config.end_effector is None:
            raise ValueError(
                f'task.hold = "end_effector": fleet[{i}], vehicle {config.name!r}, has no table '
                '[end_effector]; fly vehicles with an arm, or give hold = "hull"'
            )
    stages, gains = controller.stack()
    for stage, numbers in zip(stages, gains, strict=True):
        if isinstance(numbers, CargoPartGains):
            raise ValueError(
                f"controller.stages: {stage.name!r} knows a load below the robot, and task.hold = "
                '"end_effector" has it at the arm; take the stage grip_moment'
            )


def locate_tips(fleet: Sequence[FleetEntry]) -> np.ndarray:
    """Return the end effectors [R, 3] m of all robots in F, with their joints at home."""
    tips = []
    with jax.ensure_compile_time_eval():
        for entry in fleet:
            links = build_links(library.load_vehicle(entry.vehicle), entry.parameter_set)
            assert links is not None  # a vehicle file with an end effector has links
            tip = np.asarray(locate_end_effector(links, links.home).position, float)
            tips += [tip] * entry.count
    return np.array(tips)


def takes_poses(controller: ControllerConfig) -> bool:
    """Return whether a stage of the controller takes poses."""
    return any(PoseTarget in stage.takes for stage in controller.stack()[0])


def check_takes_poses(
    planner: PlannerConfig, execution: ExecutionConfig, controller: ControllerConfig
) -> None:
    """Refuse controllers that take no poses, where plans are updated in flight."""
    if takes_poses(controller):
        return
    key = f"planner.replan_hz = {planner.replan_hz:g}"
    if execution.order == "kept":
        key = 'execution.order = "kept"'
    raise ValueError(
        f"{key}: guides robots by poses, and no stage of controller {controller.title!r} takes "
        "one; take another, such as cascade"
    )


def check_grip_record(store: StoreConfig, *, carries: bool) -> None:
    """Refuse records of grips where robots hold nothing."""
    if "grips" in store.also and not carries:
        raise ValueError(
            'store.also: "grips" are those of task.type = "carry"; leave it out, or take that task'
        )


def check_acoustics(acoustics: AcousticsConfig, store: StoreConfig, planner: PlannerConfig) -> None:
    """Refuse records of packets without acoustics, and replanning with them."""
    if "acoustics" in store.also and acoustics.model == "perfect":
        raise ValueError(
            'store.also: "acoustics" is of packets, and acoustics.model = "perfect" has none; '
            "leave it out, or take another model"
        )
    if acoustics.model != "perfect" and planner.replan_hz:
        raise ValueError(
            f"planner.replan_hz = {planner.replan_hz:g}: replanning needs the positions of all "
            "robots, which acoustics do not provide; leave it out, or take acoustics.model = "
            '"perfect", or order = "kept" or a policy, which use received packets alone'
        )
