"""Command all robots in every control step by a policy: straight to the goal.

The policy is traced into the compiled loop. Its numbers are arguments of the compiled programs, so
other numbers cost no compilation. On the command line:
`angler rollout reef_fleet --policy docs/examples/policy.py:Straight`
"""

from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp

import angler_mjx as angler


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Straight(angler.Policy):
    """Straight to the goal at one speed."""

    speed_mps: Any = 0.4

    def act(self, carry: Any, inputs: Any, key: jax.Array, step: jax.Array) -> Any:
        """Return the command of each robot: a pose ahead of it, and the speed to go there."""
        offset = inputs.goal_m - inputs.belief.p
        distance = jnp.linalg.norm(offset, axis=-1, keepdims=True)
        velocity = self.speed_mps * offset / jnp.maximum(distance, 1.0)
        target = angler.PoseTarget(
            position_m=inputs.belief.p + velocity,
            velocity_mps=velocity,
            yaw_rad=jnp.arctan2(offset[:, 1], offset[:, 0]),
        )
        return carry, target


def main(speeds: tuple[float, ...] = (0.1, 0.2, 0.4)) -> list[float]:
    """Return the mean distance [m] that is left after a minute, for each speed."""
    scenario = angler.load_scenario("open_water_current", worlds=8, time={"horizon_s": 60.0})
    simulator = angler.Simulator(scenario, policy=Straight())
    worlds, left_m = simulator.worlds(seed=3), []
    for speed in speeds:
        policy = Straight(speed_mps=speed)
        state = simulator.reset(worlds, policy=policy)
        for _ in range(simulator.segments):
            state, _ = simulator.segment(worlds, state, policy=policy)
        distance = jnp.linalg.norm(state.vehicles.p - worlds.environment.goal_m, axis=-1)
        left_m.append(float(distance.mean()))
        print(f"{speed} m/s: {left_m[-1]:.1f} m left")
    return left_m


if __name__ == "__main__":
    main()
