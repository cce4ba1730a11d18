"""How much a run holds: its trajectories on disk, and finished tiles in memory."""

import numpy as np
import psutil

from angler_mjx.errors import ConfigError, RunError, size
from angler_mjx.robot.control.joint_trajectory import JointTrajectory
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.runs.storage.device_to_host import task_sizes
from angler_mjx.runs.storage.recorder import Shape


def shape_of(simulator: Simulator) -> Shape:
    """Sizes of a run's trajectories."""
    scenario = simulator.scenario
    world = simulator.world_shape()
    return Shape(
        worlds=scenario.worlds,
        samples=simulator.samples * simulator.segments,
        robots=len(scenario.members()),
        thrusters=world.control.vehicle.B.shape[-1],
        obstacles=world.environment.obstacles.kind.shape[-1],
        plan_points=world.path.time_s.shape[-1],
        jointed=isinstance(world.path, JointTrajectory),
        estimated=scenario.senses,
        finely=scenario.store,
        also=scenario.store.also,
        task=task_sizes(world.task),
    )


def room(simulator: Simulator, chunk: int | None) -> int:
    """Finished tiles held in memory until they are written.

    Raises:
        ConfigError: the chunk is not even one world.
        RunError: the samples of one wave do not fit into the machine's memory.
    """
    if chunk is not None and chunk < 1:
        raise ConfigError(f"--chunk {chunk}: must be at least 1 world")
    per_world = 0
    if simulator.scenario.time.record_hz > 0:
        per_world = shape_of(simulator).bytes_per_world()
    free = psutil.virtual_memory().available
    in_wave = simulator.devices * simulator.tile
    if in_wave * per_world > free:
        fits = free // per_world // simulator.devices
        raise RunError(
            f"--tile {simulator.tile}: the trajectories of {in_wave} worlds at once need "
            f"{size(in_wave * per_world)} of memory, {size(free)} are free; the "
            f"largest tile that fits is about {fits} worlds; or lower --record-hz or --devices"
        )
    if chunk is not None:
        return max(1, chunk // simulator.tile)
    # A quarter of the free memory, twice the arrays: samples come in parts and are joined.
    return int(np.clip(free // 4 // max(2 * simulator.tile * per_world, 1), 1, 64))
