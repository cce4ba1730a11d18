"""Who is waited for, and for how long: robots are where they are told to be, or stand."""

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.planning.online import guidance, order
from angler_mjx.robot.control.commands import Estimate
from angler_mjx.robot.control.laws.follow import FollowGains

from ...compiling import quickly
from .test_order import CROSS

DT = 0.1
RADIUS = np.array([0.3, 0.3], np.float32)
CRUISE = np.array([1.0, 1.0], np.float32)


@pytest.fixture(scope="module")
def flown():
    """Clocks of the team of `CROSS` each step; the first robot stands from a time on."""
    level = np.tile(np.array([1, 0, 0, 0], np.float32), (2, 1))
    kept = quickly(order.build_order)(CROSS, guidance.reach_m(RADIUS))
    step = quickly(
        lambda carry, at, standing: guidance.step(
            FollowGains(),
            carry,
            Estimate(p=at, q=level, nu=jnp.zeros((2, 6))),
            CROSS,
            kept,
            CRUISE,
            DT,
            standing,
        )
    )

    def fly(stands_s, end_s, patient):
        at = np.array(CROSS.position_m[:, 0])
        carry = guidance.initial_clocks(level)
        standing = None if patient else guidance.initial_status(carry.clock_s)
        clocks = []
        for k in range(round(end_s / DT)):
            carry, target, standing = step(carry, at, standing)
            stands = [[k * DT >= stands_s], [False]]
            at = np.where(stands, at, np.asarray(target.position_m)).astype(np.float32)
            clocks.append(np.asarray(carry.clock_s))
        return np.array(clocks)

    return fly


def test_who_stands_for_long_is_waited_for_no_longer(flown):
    """The first stands before the crossing, from 2 s on; the second is due there at 10 s."""
    for_ever = flown(2.0, 45.0, patient=True)
    assert for_ever[-1, 1] < 10.0
    clocks = flown(2.0, 45.0, patient=False)
    passes = DT * np.argmax(clocks[:, 1] > 12.0)
    assert 2.0 + guidance.PATIENCE_S < passes < 2.0 + guidance.PATIENCE_S + 12.0


def test_who_is_held_or_has_arrived_does_not_stand(flown):
    """The second waits at its start for 5 s, and both stand at their goals in the end."""
    patient, other = (flown(1e9, 40.0, patient=x) for x in (True, False))
    np.testing.assert_array_equal(patient, other)


def test_who_flies_new_plans_every_second_does_not_stand():
    """Clocks begin anew with each plan; who gets on upon none of them stands."""
    clocks = np.zeros(2, np.float32)
    standing, waits = guidance.initial_status(jnp.asarray(clocks)), np.zeros(2, bool)
    for _ in range(20):
        for _ in range(5):
            clocks = clocks + np.float32([0.2, 0.0])
            standing = guidance.update_status(standing, clocks, waits, 0.2)
        standing = guidance.shift_status(standing, clocks, np.zeros(2, np.float32))
        clocks = np.zeros(2, np.float32)
    assert standing.for_s[0] < 1.0
    np.testing.assert_allclose(standing.for_s[1], 20.0, rtol=1e-4)
