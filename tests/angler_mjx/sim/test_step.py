"""The phases of a control step by hand: what each hands on, and at which times."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np

from angler_mjx.robot.control.commands.whole_body import JointTarget
from angler_mjx.sim import step
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.state import Outcome


def test_the_physics_steps_follow_each_other_in_time():
    """They begin when the control step begins, a physics step apart, each with the one before."""
    seen, held = [], []

    def physics_step(params, vehicle, thrust_n, current, t, joints):
        seen.append((params, float(vehicle.p[0]), float(thrust_n), current, float(t)))
        held.append((float(joints.position[0]), float(joints.velocity[0])))
        return VehicleState(**{**vars(vehicle), "p": vehicle.p + 1.0})

    def repeat(times, body, tree):
        for i in range(times):
            tree = body(jnp.asarray(i), tree)
        return tree

    batch = SimpleNamespace(
        spec=SimpleNamespace(physics_steps=4, physics_dt_s=0.02, also=()),
        t=jnp.asarray(0.8),
        flow=lambda current, vehicle: vehicle.p * 0.1,
        map_bodies=lambda function, *bodies: function(*bodies),
        repeat=repeat,
        physics_step=physics_step,
    )
    vehicle = VehicleState(
        p=jnp.array([5.0, 0.0, -3.0]),
        q=jnp.array([1.0, 0.0, 0.0, 0.0]),
        nu=jnp.zeros(6),
        force_before=jnp.zeros(6),
        thrust=jnp.zeros(8),
    )
    outcome = jnp.asarray(Outcome.RUNNING)
    inputs = step.MoveInput(
        vehicle=vehicle,
        tally=SimpleNamespace(outcome=outcome),
        thrust_n=jnp.asarray(7.0),
        params="params",
        current="current",
        joints=JointTarget(
            position=jnp.array([1.0]), velocity=jnp.array([0.5]), acceleration=jnp.array([10.0])
        ),
    )
    done = step.move_robots(batch, inputs)
    assert not seen, "nothing moves before it is asked for"
    motion, record = done.output(), done.record()
    np.testing.assert_allclose([row[4] for row in seen], [0.8, 0.82, 0.84, 0.86], atol=1e-6)
    assert [row[1] for row in seen] == [5.0, 6.0, 7.0, 8.0]
    # Servos follow the target as it moves on: 1 + 0.5 t + 5 t^2, and 0.5 + 10 t.
    expected = [(1.0, 0.5), (1.012, 0.7), (1.028, 0.9), (1.048, 1.1)]
    np.testing.assert_allclose(held, expected, atol=1e-6)
    assert {(row[0], row[2], row[3]) for row in seen} == {("params", 7.0, "current")}
    np.testing.assert_array_equal(motion.vehicle.p, [9.0, 4.0, 1.0])
    np.testing.assert_array_equal(motion.before_m, vehicle.p)
    assert not motion.broken
    # What is recorded is that of the beginning.
    np.testing.assert_array_equal(record["p"], vehicle.p)
    np.testing.assert_allclose(record["current_mps"], vehicle.p * 0.1)
