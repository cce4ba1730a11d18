"""Differentiate a flight: how the distance from a goal changes with the speed of a policy.

The derivative goes through controllers, thrusters, hydrodynamics and the current of every step. It
is compared with a difference of two flights.
"""

import jax
import jax.numpy as jnp
from policy import Straight

import angler_mjx as angler


def main(speed_mps: float = 0.3, steps: int = 20) -> tuple[float, float]:
    """Return the derivative of the mean distance [m] by the speed [m/s], and the difference."""
    scenario = angler.load_scenario("open_water_current", worlds=8, time={"horizon_s": 60.0})
    simulator = angler.Simulator(scenario, policy=Straight())
    worlds = simulator.worlds(seed=3)
    start = simulator.reset(worlds)
    flown = simulator.add_parameters(worlds)

    def distance_m(speed: jax.Array) -> jax.Array:
        after, *_ = simulator.engine.segment(
            simulator.spec,
            simulator.fleet,
            flown,
            start,
            n_sample=1,
            steps_per_sample=steps,
            policy=Straight(speed_mps=speed),
        )
        return jnp.linalg.norm(after.vehicles.p - worlds.environment.goal_m, axis=-1).mean()

    def fly(speed: jax.Array) -> tuple[jax.Array, jax.Array]:
        return jax.jvp(distance_m, (speed,), (jnp.ones_like(speed),))

    compiled, step = jax.jit(fly), 0.01
    slope = float(compiled(jnp.float32(speed_mps))[1])
    farther, nearer = (compiled(jnp.float32(speed_mps + by))[0] for by in (-step, step))
    difference = float(nearer - farther) / (2 * step)
    print(f"derivative {slope:.4f}, difference {difference:.4f} m per m/s")
    return slope, difference


if __name__ == "__main__":
    main()
