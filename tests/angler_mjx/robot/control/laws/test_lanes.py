"""On lanes every law gives what it gives under vmap."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels import lanes
from angler_mjx.robot.control.commands import BodyTwist, BodyWrench
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.laws import (
    aitsm,
    computed_torque,
    ismc,
    los,
    pid_pose,
    pid_velocity,
    tracking,
)
from angler_mjx.robot.control.laws.ardusub import law as ardusub
from angler_mjx.robot.vehicles import library, params

from ....compiling import quickly

POINTS = np.array([[0, 0, -10], [2, 0, -10], [2, 3, -11], [2, 3, -11.0]])
GAINS = {
    "pid_pose": (pid_pose, pid_pose.PidPoseGains(), "pose"),
    "pid_velocity": (pid_velocity, pid_velocity.PidVelocityGains(), "twist"),
    "computed_torque": (computed_torque, computed_torque.ComputedTorqueGains(), "tracking"),
    "tracking": (tracking, tracking.TrackingGains(), "tracking"),
    "ismc": (ismc, ismc.IsmcGains(), "twist"),
    "aitsm": (aitsm, aitsm.AitsmGains(), "twist"),
    "los": (los, los.LosGains(), "path"),
    "ardusub": (ardusub, ardusub.ArduSubGains(), "pose"),
}


@pytest.mark.parametrize("name", GAINS)
def test_lanes_agree_with_vmap(robots, states, pool, name):
    vehicles, _ = robots
    estimate, target = states
    law, gains, kind = GAINS[name]
    commands = {
        "pose": pool.as_pose(target),
        "tracking": target,
        "twist": BodyTwist(nu=estimate.nu[::-1]),
        "path": Trajectory(
            time_s=jnp.tile(jnp.array([0.0, 5.0, 12.0, 12.0]), (4, 1)),
            position_m=jnp.tile(jnp.asarray(POINTS), (4, 1, 1)),
            found=jnp.ones(4, bool),
        ),
    }
    wrench = BodyWrench(tau=estimate.nu * 3.0)
    more = {"realised": wrench} if name in ("pid_velocity", "tracking") else {}

    def twice(vehicle, at, command, more):
        """Two steps: the second has a memory to read."""
        carry = law.reset(at)
        for _ in range(2):
            carry, out = law.step(gains, vehicle, carry, at, command, 0.05, 1000.0, 9.81, **more)
        return carry, out

    args = (vehicles, estimate, commands[kind], more)
    expected = quickly(jax.vmap(twice))(*args)
    found = quickly(lambda *x: lanes.join(lanes.apply(twice, *lanes.split(x))))(*args)
    for x, y in zip(jax.tree.leaves(expected), jax.tree.leaves(found), strict=True):
        # float32 sums in another order; wrenches are of tens of newtons, signals of 1500 us.
        np.testing.assert_allclose(
            np.broadcast_to(np.asarray(y, float), x.shape),
            np.asarray(x, float),
            rtol=1e-4,
            atol=1e-4,
        )


def test_laws_are_as_good_in_double(states, pool):
    """The same in float64, to the rounding of float32: no constant narrows or widens the work."""
    estimate, target = jax.tree.map(lambda x: np.asarray(x[0]), states)

    @quickly
    def steps(vehicle, at, goal):
        """What each law makes of it, by name."""
        dtype = at.p.dtype
        commands = {
            "pose": pool.as_pose(goal),
            "tracking": goal,
            "twist": BodyTwist(nu=at.nu[::-1]),
            "path": Trajectory(
                time_s=jnp.array([0.0, 5.0, 12.0, 12.0], dtype),
                position_m=jnp.asarray(POINTS, dtype),
                found=jnp.asarray(True),
            ),
        }
        return {
            name: law.step(gains, vehicle, law.reset(at), at, commands[kind], 0.05, 1000.0, 9.81)
            for name, (law, gains, kind) in GAINS.items()
        }

    def run(dtype):
        at, goal = jax.tree.map(lambda x: jnp.asarray(x, dtype), (estimate, target))
        vehicle = params.build_vehicle(library.load_vehicle("bluerov2_heavy"), "wu2018", 14.8)
        found = steps(vehicle, at, goal)
        for name, made in found.items():
            for leaf in jax.tree.leaves(made):
                assert leaf.dtype in (dtype, jnp.bool_, jnp.int32), name
        return {name: np.asarray(jax.tree.leaves(out)[0]) for name, (_, out) in found.items()}

    single = run(jnp.float32)
    with jax.enable_x64(True):
        double = run(jnp.float64)
    for name in GAINS:
        np.testing.assert_allclose(single[name], double[name], rtol=1e-4, atol=1e-3, err_msg=name)
