"""Sizes of a run: its trajectories on disk, and finished tiles in memory."""

import numpy as np
import psutil

from angler_mjx.errors import ConfigError, RunError, format_bytes
from angler_mjx.robot.control.commands.joint_trajectory import VEHICLE_JOINTS, JointTrajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.device_to_host import task_sizes
from angler_mjx.runs.storage.recorder import TrajectoryShape
from angler_mjx.sim.fleet import label_joints


def trajectory_shape(simulator: Simulator) -> TrajectoryShape:
    """Return the sizes of a run's trajectories."""
    scenario = simulator.scenario
    world = simulator.world_shape()
    return TrajectoryShape(
        worlds=scenario.worlds,
        samples=simulator.samples * simulator.segments,
        robots=len(scenario.members()),
        thrusters=simulator.thrusters,
        obstacles=world.environment.obstacles.kind.shape[-1],
        plan_points=world.path.time_s.shape[-1],
        jointed=isinstance(world.path, JointTrajectory),
        armed=isinstance(world.path, JointTrajectory)
        and len(world.path.joints) > len(VEHICLE_JOINTS),
        estimated=scenario.senses,
        store_config=scenario.store,
        also=scenario.store.also,
        task=task_sizes(world.task),
        joints=label_joints(scenario.members()),
    )


def max_buffered_tiles(simulator: Simulator, chunk: int | None) -> int:
    """Return the number of finished tiles held in memory until they are written.

    Raises:
        ConfigError: the chunk is not even one world.
        RunError: the samples of one device batch do not fit into the machine's memory.
    """
    if chunk is not None and chunk < 1:
        raise ConfigError(f"--chunk {chunk}: must be at least 1 world")
    per_world = 0
    if simulator.scenario.time.record_hz > 0:
        per_world = trajectory_shape(simulator).bytes_per_world()
    free = psutil.virtual_memory().available
    in_batch = simulator.devices * simulator.tile
    if in_batch * per_world > free:
        max_tile = free // per_world // simulator.devices
        raise RunError(
            f"--tile {simulator.tile}: the trajectories of {in_batch} worlds at once need "
            f"{format_bytes(in_batch * per_world)} of memory, {format_bytes(free)} are free; the "
            f"largest tile that fits is about {max_tile} worlds; or lower --record-hz or --devices"
        )
    if chunk is not None:
        return max(1, chunk // simulator.tile)
    # A quarter of the free memory, twice the arrays: samples come in parts and are joined.
    return int(np.clip(free // 4 // max(2 * simulator.tile * per_world, 1), 1, 64))
