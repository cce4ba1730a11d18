"""Where a vehicle's bow is told to point, and how fast it may be told to go."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import quaternion
from angler_mjx.robot.control.laws import model

NOW = 0.4
"""Heading of the vehicle, rad."""


def told(terminal, velocity, asked=-1.0):
    vehicle = SimpleNamespace(terminal_speed_mps=jnp.array(terminal), steered=True)
    estimate = SimpleNamespace(q=quaternion.from_yaw(jnp.asarray(NOW)))
    return float(model.choose_heading(vehicle, estimate, jnp.array(velocity), jnp.asarray(asked)))


def test_a_vehicle_with_sway_keeps_the_heading_asked_for():
    assert told([1.5, 1.0, 1.0], [0.0, 0.5, 0.0]) == np.float32(-1.0)


@pytest.mark.parametrize(
    ("velocity", "heading"),
    [
        ([0.5 * np.cos(0.6), 0.5 * np.sin(0.6), 0.2], 0.6),  # within reach: the course itself
        ([0.0, 0.5, 0.0], NOW + model.TURN_RAD),  # to port
        ([0.0, -0.5, 0.0], NOW - model.TURN_RAD),  # to starboard
        ([-0.5, -0.3, 0.0], NOW - model.TURN_RAD),  # nearly back: the short way round
        ([0.01, 0.01, 0.5], -1.0),  # straight up: as asked
    ],
)
def test_one_without_turns_its_bow_to_where_it_goes(velocity, heading):
    assert told([1.5, 0.0, 1.0], velocity) == pytest.approx(heading, abs=1e-5)


@pytest.mark.parametrize(
    ("terminal", "limit"),
    [([1.5, 1.0, 0.8], 0.72), ([1.5, 0.0, 1.0], 0.9), ([0.0, 0.0, 0.0], 0.0)],
)
def test_speed_is_held_to_the_slowest_way_that_is_there(terminal, limit):
    vehicle = SimpleNamespace(terminal_speed_mps=jnp.array(terminal), steered=True)
    assert float(model.speed_limit(vehicle)) == pytest.approx(limit)
