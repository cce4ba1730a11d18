"""Every law that ends in a wrench, on every flyable parameter set, in closed loop with the physics.

The currents are known to nobody, but in one test: laws that need an integral have one.
"""

import numpy as np
import pytest

from angler_mjx.robot.control.laws import (
    aitsm,
    computed_torque,
    ismc,
    pid_pose,
    pid_velocity,
    tracking,
)

DT, DENSITY, GRAVITY = 0.05, 1000.0, 9.81


def on_tracking(pool, law, gains):
    return pool.Controller(
        law.reset,
        lambda gains, vehicle, carry, at, target, flow: law.step(
            gains, vehicle, carry, at, target, DT, DENSITY, GRAVITY, flow
        ),
        gains,
    )


def on_twist(pool, law, gains, *, told_current=True):
    """Below the pose loop."""

    def control(gains, vehicle, carry, at, target, flow):
        pose = pool.as_pose(target)
        above, twist = pid_pose.step(
            pid_pose.PidPoseGains(), vehicle, carry[0], at, pose, DT, DENSITY, GRAVITY
        )
        more = {"flow": flow} if told_current else {}
        below, wrench = law.step(gains, vehicle, carry[1], at, twist, DT, DENSITY, GRAVITY, **more)
        return (above, below), wrench

    return pool.Controller(lambda at: (pid_pose.reset(at), law.reset(at)), control, gains)


@pytest.fixture(scope="module")
def flown(pool):
    """Flights of each law by name."""
    pid = pid_velocity.PidVelocityGains()
    controllers = {
        "pid": on_twist(pool, pid_velocity, pid, told_current=False),
        "computed_torque": on_tracking(
            pool, computed_torque, computed_torque.ComputedTorqueGains()
        ),
        "tracking": on_tracking(pool, tracking, tracking.TrackingGains()),
        "ismc": on_twist(pool, ismc, ismc.IsmcGains()),
        "aitsm": on_twist(pool, aitsm, aitsm.AitsmGains()),
    }
    proportional = pid_velocity.PidVelocityGains(
        velocity_per_s=2.5, velocity_integral_per_s2=0.0, rate_integral_per_s2=0.0
    )
    without = tracking.TrackingGains(integral_per_s2=0.0)
    variants = {name: pool.Variant(name) for name in controllers} | {
        "p": pool.Variant("pid", proportional),
        "tracking, current known": pool.Variant("tracking", without, current_known=True),
    }
    return pool.fly(controllers, variants)


ALL = ["pid", "computed_torque", "tracking", "ismc", "aitsm"]


@pytest.mark.parametrize("law", ALL)
def test_steps_settle(flown, pool, law):
    flights = flown[law]
    for scenario in (pool.STEP, pool.TURN):
        metres, degrees = flights.steady(scenario)
        # The wanted 2 cm and 1 degree; 0.1 cm and 0.1 degree are had.
        assert metres.max() < 0.02, dict(zip(pool.kinds, metres, strict=True))
        assert degrees.max() < 1.0, dict(zip(pool.kinds, degrees, strict=True))
        # 2 m at the 0.7 m/s of the slowest, and then four times 1/0.8 s; the slowest takes 8.7 s.
        assert flights.settled_s(scenario).max() < 10
    # No sustained oscillation. The BlueROV2's pitch has no control, and quadratic drag alone damps
    # it: 3e-3 rad/s is left there, tenths of that elsewhere.
    assert flights.swing().max() < 0.01
    # One step across the dead band would be 56 us.
    assert flights.pwm[:, :2, -200:].std(axis=2).max() < 15


@pytest.mark.parametrize("law", ALL)
def test_station_is_kept_in_a_current(flown, pool, law):
    """0.5 m/s at 40 degrees off the bow: von_benzon2022 (0.77 m/s in sway) can, with its whole
    thrust nearly."""
    flights = flown[law]
    metres, degrees = flights.steady(pool.CURRENT)
    # The wanted 5 cm; 0.6 cm are had. Heading as in still water.
    assert metres.max() < 0.05, dict(zip(pool.kinds, metres, strict=True))
    assert degrees.max() < 1.0
    # Before the integrals hold it, it is carried off: 1 m is one that never catches up.
    assert flights.error[:, pool.CURRENT].max() < 1.0


@pytest.mark.parametrize("law", ["computed_torque", "tracking", "ismc", "aitsm"])
def test_a_figure_of_eight_is_followed(flown, pool, law):
    flights = flown[law]
    # The wanted 5 cm; 0.3 cm are had with feed-forward of acceleration, 1.4 cm without (ismc).
    assert flights.rmse(pool.EIGHT).max() < 0.05
    # Heading: the laws that take a target with its turn feed that forward, 7 degrees while 1 rad/s
    # is turned; a pose target has none, and P of 2.5 lags by 1 / 2.5 rad at most.
    limit = 10 if law in ("computed_torque", "tracking") else 30
    assert flights.off_deg[:, pool.EIGHT].max() < limit


def test_feed_forward_is_what_follows(flown, pool):
    """Without a model the same eight is left by more, on every set."""
    assert np.all(flown["pid"].rmse(pool.EIGHT) > 5 * flown["tracking"].rmse(pool.EIGHT))


def test_sliding_and_integrals_reject_what_proportional_control_does_not(flown, pool):
    plain, _ = flown["p"].steady(pool.CURRENT)
    sliding, _ = flown["ismc"].steady(pool.CURRENT)
    # Drag of 7 to 50 N over K_p = 0.8 * 2.5 * (m + m_A): 12 cm on the least, twice that for most.
    assert plain.min() > 0.1
    assert sliding.max() < 0.01


def test_a_known_current_is_fed_forward(flown, pool):
    """Without any integral, station is kept from the first moment where the current is known."""
    flights = flown["tracking, current known"]
    # What the start from rest in a current costs: the rotors' lag and one control period.
    assert flights.error[:, pool.CURRENT].max() < 0.05
    metres, _ = flights.steady(pool.CURRENT)
    assert metres.max() < 0.02


def test_vehicles_stay_level(flown, pool):
    """With the Munk moment undone, a step along three axes at once tilts little."""
    for law in ("computed_torque", "tracking", "ismc", "aitsm"):
        # 7 degrees at most; the PID, that does not know the moment, tilts by 21.
        assert flown[law].tilt_deg[:, : pool.EIGHT].max() < 10
