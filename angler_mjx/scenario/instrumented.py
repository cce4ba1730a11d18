"""Robots whose controllers use an estimate: neighbours with equal instruments form a group."""

import itertools
from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import jax
import jax.numpy as jnp

from angler_mjx.robot.control.navigation import NavigationParams
from angler_mjx.robot.sensing import params
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.sim.state import InstrumentedRobots

type Source = Literal["truth", "noisy", "ekf"]
"""State that the controllers use: true, true with white noise, or a filter's estimate."""


def uses_true_state(source: Source, config: SensorsConfig) -> bool:
    """Return whether controllers use the true state; so they do with noise switched off."""
    return source == "truth" or (source == "noisy" and not config.noise)


def build_groups(
    robots: Sequence[tuple[Source, SensorsConfig]], control_dt_s: float, gravity_mps2: float
) -> tuple[InstrumentedRobots, ...]:
    """Compile the instruments of a fleet (host side).

    Args:
        robots: source of the state and instruments of each robot.
        control_dt_s: control period, s.
        gravity_mps2: m/s^2.

    Raises:
        ConfigError: see `angler_mjx.robot.sensing.params.check_sensors`.
    """
    groups, first = [], 0
    for (source, is_true, _), members in itertools.groupby(robots, _group_key):
        sensor_params = [
            params.build_sensors(config, control_dt_s, gravity_mps2) for _, config in members
        ]
        if source != "truth" and not is_true:
            sensors: params.SensorParams = jax.tree.map(lambda *x: jnp.stack(x), *sensor_params)
            groups.append(
                InstrumentedRobots(
                    first=first,
                    count=len(sensor_params),
                    source=source,
                    params=_repeat_parameters(
                        NavigationParams(sensors=sensors), len(sensor_params)
                    ),
                )
            )
        first += len(sensor_params)
    return tuple(groups)


def _group_key(robot: tuple[Source, SensorsConfig]) -> tuple[Source, bool, bool]:
    """Return the properties that the robots of a group share."""
    source, config = robot
    return source, uses_true_state(source, config), config.noise


def _repeat_parameters(navigation: NavigationParams, count: int) -> NavigationParams:
    """Return the parameters with their numbers repeated for each robot."""
    return replace(
        navigation,
        initial_position_m=jnp.full(count, navigation.initial_position_m),
        initial_velocity_mps=jnp.full(count, navigation.initial_velocity_mps),
        initial_level_rad=jnp.full(count, navigation.initial_level_rad),
        initial_heading_rad=jnp.full(count, navigation.initial_heading_rad),
    )
