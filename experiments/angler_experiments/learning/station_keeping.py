"""PPO against the cascade: station keeping among vortices, with one BlueROV2 Heavy.

    python -m angler_experiments.learning.station_keeping --minutes 10
    python -m angler_experiments.learning.station_keeping --smoke

The agent gives velocities to the velocity controller; the cascade is commanded to hold the pose.
Both fly the same worlds, which are not in the training set. Needs the extra ``learn`` (Brax's PPO).
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import tyro

from angler_mjx.learning.environment import EnvState, FleetEnv, make_env
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario

SCENARIO = Path(__file__).with_name("station_keeping.toml")
OBSERVATION = ("velocity", "upright", "goal", "heading", "current", "action")
REWARD = {
    "distance": -1.0,
    "heading": -0.2,
    "energy": -0.1,
    "roughness": -0.002,
    "collision": -1.0,
}
SPEED_SCALE = (0.8, 0.8, 0.5, 0.3, 0.3, 0.6)
"""Velocity of an action of 1, m/s and rad/s."""
EVALUATION_SEED = 1_000_003
"""Seed of the evaluated worlds."""


@dataclass(frozen=True, kw_only=True)
class TrainingSize:
    """Size of a training."""

    worlds: int
    bank: int
    evaluation_worlds: int
    minutes: float
    unroll: int = 20
    batch: int = 64
    minibatches: int = 8


@dataclass(frozen=True, kw_only=True)
class StationFlight:
    """Result of flights."""

    rms_m: float
    late_rms_m: float
    """Root mean square error of the second half of the episodes."""
    energy_j: float
    """Mean energy of an episode."""
    failed: int
    """Number of episodes that ended early."""

    def format_line(self, name: str) -> str:
        """Format a line for people."""
        return (
            f"{name:8} RMS error {self.rms_m:.3f} m (second half {self.late_rms_m:.3f} m), "
            f"energy {self.energy_j:,.0f} J, {self.failed} failed"
        )


class OutOfTimeError(Exception):
    """Expired time of a training."""


type ActionPolicy = Callable[[jax.Array, jax.Array], tuple[jax.Array, object]]
"""Observation and key to an action, and further results."""

type Flown = tuple[jax.Array, jax.Array, jax.Array]
"""Distances to the aim, energies and ends by step."""


def train(env: FleetEnv, size: TrainingSize, seed: int = 0) -> tuple[ActionPolicy, int, float]:
    """Return a policy (observation, key) -> action; and the steps and seconds of its training."""
    from brax.training.agents.ppo import networks as ppo_networks
    from brax.training.agents.ppo import train as ppo

    from angler_experiments.learning.brax_env import BraxFleet, patch_device_put

    start_s = time.perf_counter()
    last: list[tuple[int, Callable[..., ActionPolicy], object]] = []
    steps_per_update = size.batch * size.minibatches * size.unroll

    def on_progress(step: int, make_policy: Callable[..., ActionPolicy], params: object) -> None:
        last[:] = [(step, make_policy, params)]
        if time.perf_counter() - start_s > 60.0 * size.minutes and step:
            raise OutOfTimeError

    hidden = (64, 64)
    networks = partial(
        ppo_networks.make_ppo_networks,
        policy_hidden_layer_sizes=hidden,
        value_hidden_layer_sizes=hidden,
    )
    try:
        with patch_device_put():
            ppo.train(
                environment=BraxFleet(env),
                num_timesteps=100_000 * steps_per_update,
                num_evals=10_001,
                run_evals=False,
                num_envs=env.worlds,
                episode_length=env.rules.horizon,
                wrap_env_fn=BraxFleet.unbatched,
                unroll_length=size.unroll,
                batch_size=size.batch,
                num_minibatches=size.minibatches,
                num_updates_per_batch=4,
                learning_rate=1e-3,
                entropy_cost=1e-3,
                discounting=0.97,
                reward_scaling=10.0,
                normalize_observations=True,
                network_factory=networks,
                seed=seed,
                policy_params_fn=on_progress,
            )
    except OutOfTimeError:
        pass
    step, make_policy, params = last[0]
    copied = jax.tree.map(lambda leaf: jnp.array(leaf), params)
    return make_policy(copied, deterministic=True), step, time.perf_counter() - start_s


def evaluate_policy(env: FleetEnv, act: Callable[[jax.Array], jax.Array]) -> StationFlight:
    """Fly all worlds of an environment's bank once, by a function of observations [W, 1, size]."""

    def fly(env: FleetEnv) -> Flown:
        def step_env(
            carry: tuple[EnvState, jax.Array], __: None
        ) -> tuple[tuple[EnvState, jax.Array], Flown]:
            state, observation = carry
            state, observation, _, terminated, _, info = env.step(state, act(observation))
            return (state, observation), (
                info["aim_distance_m"][:, 0],
                info["energy_j"][:, 0],
                terminated,
            )

        flown: Flown = jax.lax.scan(step_env, env.reset(), length=env.rules.horizon)[1]
        return flown

    distance_m, energy, terminated = map(np.asarray, jax.jit(fly)(env))
    is_ended = np.cumsum(terminated, axis=0) - terminated > 0  # of the world that replaced it
    first_episode = np.ma.masked_array(distance_m, is_ended)
    half = len(distance_m) // 2
    return StationFlight(
        rms_m=float(np.sqrt((first_episode**2).mean())),
        late_rms_m=float(np.sqrt((first_episode[half:] ** 2).mean())),
        energy_j=float(np.ma.masked_array(energy, is_ended).max(axis=0).mean()),
        failed=int(terminated.any(axis=0).sum()),
    )


def main(minutes: float = 10.0, worlds: int = 256, seed: int = 0, smoke: bool = False) -> None:
    """Train, fly and compare.

    Args:
        minutes: minutes of training, compiling included.
        worlds: number of worlds in the batch.
        seed: seed of the training.
        smoke: a few updates on a few worlds, to see that it runs.
    """
    size = TrainingSize(worlds=worlds, bank=2 * worlds, evaluation_worlds=128, minutes=minutes)
    if smoke:
        size = TrainingSize(
            worlds=8, bank=8, evaluation_worlds=8, minutes=0.0, unroll=5, batch=8, minibatches=1
        )
    simulator = Simulator(load_scenario(SCENARIO), tile=size.evaluation_worlds)
    build_env = partial(make_env, simulator, aim="start", observe=OBSERVATION, reward=REWARD)
    env = build_env(worlds=size.worlds, bank=size.bank, action="twist", scale=SPEED_SCALE)
    policy, steps, seconds = train(env, size, seed)
    print(f"trained on {steps:,} control steps in {seconds:.0f} s", flush=True)
    build_evaluation = partial(build_env, worlds=size.evaluation_worlds, seed=EVALUATION_SEED)
    learner = build_evaluation(action="twist", scale=SPEED_SCALE, bank=size.evaluation_worlds)
    agent = evaluate_policy(learner, lambda observation: policy(observation, jax.random.key(0))[0])
    cascade_env = build_evaluation(action="pose", bank=learner.bank)
    cascade = evaluate_policy(cascade_env, lambda observation: jnp.zeros(cascade_env.action_shape))
    print(agent.format_line("PPO"))
    print(cascade.format_line("cascade"))
    nearer = "PPO" if agent.rms_m < cascade.rms_m else "the cascade"
    thriftier = "PPO" if agent.energy_j < cascade.energy_j else "the cascade"
    print(f"nearer: {nearer}; thriftier: {thriftier}")


if __name__ == "__main__":
    tyro.cli(main)
