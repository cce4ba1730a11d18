"""Speed of the environment of `angler_mjx.learning` relative to `Simulator.segment`.

    python -m angler_experiments.learning.speed --worlds 8192

Both are commanded velocities of zero, or with ``--action plan`` fly their plans; the environment is
scanned in one program, which keeps the last observations, as a policy reads them, sums rewards, and
replaces ended worlds. Prints robot steps per second of both, the best of ``--repeats``, and their
ratio.
"""

import time
from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import tyro

from angler_mjx.learning.environment import EnvState, FleetEnv, make_env
from angler_mjx.robot.control.commands import BodyTwist
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario

type ScanCarry = tuple[EnvState, jax.Array, jax.Array]


def min_duration_s(run: Callable[[], object], repeats: int) -> float:
    """Return the least time of a call, after an uncounted one."""
    jax.block_until_ready(run())
    durations = []
    for _ in range(repeats):
        start_s = time.perf_counter()
        jax.block_until_ready(run())
        durations.append(time.perf_counter() - start_s)
    return min(durations)


def build_scan(steps: int) -> Callable[[FleetEnv, EnvState, jax.Array], ScanCarry]:
    """Build a program of a number of steps with actions of zeros.

    It takes an environment, its state and observations [W, R, size], and returns the state,
    observations and summed rewards [W, R] after the steps.
    """

    def fly(env: FleetEnv, state: EnvState, observation: jax.Array) -> ScanCarry:
        action = jnp.zeros(env.action_shape)

        def step_env(carry: ScanCarry, _: None) -> tuple[ScanCarry, None]:
            next_state, observation, reward = env.step(carry[0], action)[:3]
            return (next_state, observation, carry[2] + reward), None

        start = (state, observation, jnp.zeros(observation.shape[:2], observation.dtype))
        return jax.lax.scan(step_env, start, length=steps)[0]

    program: Callable[[FleetEnv, EnvState, jax.Array], ScanCarry] = jax.jit(fly)
    return program


def main(
    worlds: int = 256,
    repeats: int = 5,
    action: str = "twist",
    scenario: str = "reef_fleet",
    kernels: str = "",
    action_repeat: int = 1,
) -> None:
    """Measure both.

    Args:
        worlds: number of worlds in the batch.
        repeats: number of measurements, of which the best counts.
        action: action of the environment: plan, or twist with zeros.
        scenario: Name of a shipped scenario, or path of a scenario file (.toml).
        kernels: kernels of the fused engine in `Simulator.segment`; its default if left out.
        action_repeat: control steps that the environment holds an action for.
    """
    # Without a record `segment` keeps one sample of its steps.
    changes: dict[str, object] = {"engine": "fused", "time": {"record_hz": 0.0}}
    if kernels:
        changes["kernels"] = kernels
    simulator = Simulator(load_scenario(scenario, **changes), tile=worlds)
    worlds_state, steps = simulator.worlds(), simulator.segment_steps
    robots = worlds_state.variant.shape[1]
    command = None
    if action != "plan":
        command = BodyTwist(nu=jnp.zeros((worlds, robots, 6)))

    def segment() -> object:
        return simulator.segment(worlds_state, simulator.reset(worlds_state), command)

    reset = partial(simulator.reset, worlds_state)
    segment_s = min_duration_s(segment, repeats) - min_duration_s(reset, repeats)
    env = make_env(simulator, worlds=worlds, action=action, action_repeat=action_repeat)
    program, (state, observation) = build_scan(steps // action_repeat), env.reset()
    env_s = min_duration_s(lambda: program(env, state, observation), repeats)
    total = worlds * robots * (steps // action_repeat * action_repeat)
    print(f"{jax.devices()[0].device_kind}: {scenario}, {worlds} worlds of {robots}, {action}")
    print(f"Simulator.segment ({simulator.kernels}): {total / segment_s:,.0f} robot steps/s")
    print(f"environment: {total / env_s:,.0f} robot steps/s, {segment_s / env_s:.0%} of it")


if __name__ == "__main__":
    tyro.cli(main)
