"""Facts of a scene's robots and obstacles at the start."""

from dataclasses import dataclass

import jax
import numpy as np
from numpy.typing import NDArray

from angler_mjx.robot.control.commands.joint_goal import JointGoal
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.whole_body import JointTarget, WholeBodyCommand
from angler_mjx.robot.control.plans import Plan, of_robot
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.drive import full_force, terminal_speed
from angler_mjx.robot.vehicles.fins import lift_matrix
from angler_mjx.robot.vehicles.params import joint_names
from angler_mjx.robot.vehicles.thrust_curves import thrust_ends
from angler_mjx.runs.session.command_slots import command_types
from angler_mjx.runs.session.command_validation import CommandLimits
from angler_mjx.runs.session.interface import Floats, RobotInfo
from angler_mjx.runs.session.robot_plan import RobotPlan
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.sim.state import FleetWorld

REJOIN_WAYPOINTS = 32
"""Number of way-points of a way back to a plan, beyond those of the plan."""


@dataclass(frozen=True, kw_only=True)
class ObstacleRows:
    """Existing obstacles."""

    which: NDArray[np.integer]
    kind: NDArray[np.integer]
    size_m: Floats


@dataclass(frozen=True, kw_only=True)
class FleetFacts:
    """Facts of one world; [R] leads."""

    robots: tuple[RobotInfo, ...]
    plans: tuple[RobotPlan, ...]
    found: tuple[bool, ...]
    """Whether the planner found a path for each robot."""
    radius_m: tuple[float, ...]
    cruise_mps: tuple[float, ...]
    thrusters: int
    """Rows of the signals, padding included."""
    way_points: int
    """Number of way-points of the planner's paths."""
    jointed: bool
    """Whether these paths are trajectories of joints."""
    joints: tuple[str, ...]
    """Names of the joints of arms; empty where no robot has any."""
    obstacles: ObstacleRows
    cargo: int | None = None
    """Row in ``obstacles`` of the body that the robots hold together; None for none."""

    def command_limits(self, points: int, start_tolerance: float) -> CommandLimits:
        """Return the limits of a session of this world, at least the sizes of its own plans.

        Args:
            points: requested maximum number of points of a JointTrajectory.
            start_tolerance: see `CommandLimits`.
        """
        max_waypoints = self.way_points + REJOIN_WAYPOINTS
        return CommandLimits(
            start_tolerance=start_tolerance,
            points=max(points, max_waypoints) if self.jointed else points,
            way_points=max_waypoints,
        )


def gather_facts(simulator: Simulator, worlds: FleetWorld) -> FleetFacts:
    """Read a world.

    Args:
        simulator: simulator of its scenario.
        worlds: world, [1] leads.
    """
    count = worlds.variant.shape[1]
    path: Plan = jax.tree.map(lambda leaf: leaf[0], jax.device_get(worlds.path))
    obstacles = worlds.environment.obstacles
    rows = np.flatnonzero(np.asarray(obstacles.exists)[0])
    carried = simulator.spec.cargo
    robots = tuple(_robot_info(simulator, worlds, i) for i in range(count))
    return FleetFacts(
        robots=robots,
        plans=tuple(RobotPlan.of(of_robot(path, i)) for i in range(count)),
        found=tuple(map(bool, np.asarray(worlds.planned)[0])),
        radius_m=tuple(robot.radius_m for robot in robots),
        cruise_mps=tuple(robot.cruise_speed_mps for robot in robots),
        thrusters=worlds.control.vehicle.B.shape[-1],
        way_points=path.time_s.shape[-1],
        jointed=isinstance(path, JointTrajectory),
        joints=joint_names(worlds.control.vehicle),
        obstacles=ObstacleRows(
            which=rows,
            kind=np.asarray(obstacles.kind)[0][rows],
            size_m=np.asarray(obstacles.size_m)[0][rows],
        ),
        cargo=None if carried is None else int(np.searchsorted(rows, carried.body)),
    )


def _robot_info(simulator: Simulator, worlds: FleetWorld, i: int) -> RobotInfo:
    vehicle, parameter_set = simulator.variants()[int(worlds.variant[0, i])]
    params = worlds.control.vehicle
    config = library.load_vehicle(vehicle)
    joints = tuple(joint.name for joint in config.find_joints())
    accepts = command_types(simulator.spec.stages)
    messages = (JointGoal,) if JointTrajectory in accepts else ()
    wrench, table, linear, quadratic = (
        np.asarray(x, float)[0, i] for x in (params.B, params.thrust_n, params.D_l, params.D_q)
    )
    moment = full_force(wrench[5:], *thrust_ends(table))
    if params.fins is not None:
        fins = jax.tree.map(lambda leaf: np.asarray(leaf)[0, i], params.fins)
        speed_mps = float(params.terminal_speed_mps[0, i, 0])
        pressure_pa = 0.5 * simulator.spec.water.density_kgpm3 * speed_mps**2
        moment = moment + pressure_pa * np.abs(lift_matrix(fins)[5:]) @ fins.limit_rad
    return RobotInfo(
        name=f"robot_{i}",
        vehicle=vehicle,
        parameter_set=parameter_set,
        radius_m=float(params.radius_m[0, i]),
        cruise_speed_mps=float(worlds.control.cruise_speed_mps[0, i]),
        max_speed_mps=np.asarray(params.terminal_speed_mps, float)[0, i],
        max_turn_radps=float(terminal_speed(moment, linear[5:], quadratic[5:])[0]),
        thrusters=config.actuator_names,
        accepts=(*accepts, *messages, *((JointTarget, WholeBodyCommand) if joints else ())),
        joints=joints,
    )
