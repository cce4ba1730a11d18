"""Tune the gains of the cascade by gradient: descend the tracking cost of closed-loop rollouts.

    python -m angler_experiments.tune_gains

The cost is that of `angler_mjx.sim.engines.gradients.tracking_cost`: distances of robots from the
set-points of their paths. Adam works on the logarithms of the gains, which keeps them positive. The
printed costs at the end are of worlds that the gains were not tuned on.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

import jax
import jax.numpy as jnp
import tyro

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control.stack import StackGains
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim.engines.gradients import tracking_cost
from angler_mjx.sim.engines.lanes.engine import FusedEngine
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.state import FleetWorld, SimSpec, WorldState

TUNED = (
    ("pose", "position_per_s"),
    ("pose", "attitude_per_s"),
    ("velocity", "velocity_per_s"),
    ("velocity", "rate_per_s"),
    ("velocity", "integral_per_s2"),
)
"""Stages of the cascade, and their gains."""
ADAM_DECAY = (0.9, 0.99)
"""Decay rates of Adam's averages of the gradient and of its square from one iteration to the
next."""


@dataclass(frozen=True, kw_only=True)
class TuningResult:
    """Result of the tuning."""

    before: dict[str, float]
    after: dict[str, float]
    """Tuned gains, by stage and gain as in ``pose.position_per_s``."""
    costs_m2: list[float]
    """Cost on the worlds tuned on, before each iteration."""
    unseen_m2: tuple[float, float]
    """Cost on other worlds, before and after."""
    compile_s: float
    tune_s: float


def tune(
    scenario: str = "reef_fleet",
    worlds: int = 16,
    seconds: float = 10.0,
    iterations: int = 40,
    rate: float = 0.1,
) -> TuningResult:
    """Tune the gains of a scenario.

    Args:
        scenario: name of a shipped scenario, or path of a file.
        worlds: number of worlds to tune on.
        seconds: length of the rollouts.
        iterations: iterations of Adam.
        rate: greatest change of a gain's logarithm in an iteration.
    """
    if worlds < 1 or iterations < 1 or rate <= 0:
        raise ConfigError(
            f"worlds = {worlds}, iterations = {iterations}, rate = {rate}: all must be positive"
        )
    simulator = Simulator(load_scenario(scenario, engine="fused", kernels="xla"), tile=worlds)
    spec, engine = simulator.spec, FusedEngine()
    steps = max(1, round(seconds / spec.control_dt_s))

    @jax.jit
    def evaluate(
        theta: jax.Array, kinds: Fleet, worlds_state: FleetWorld, start: WorldState
    ) -> tuple[jax.Array, jax.Array]:
        def cost(theta: jax.Array) -> jax.Array:
            gains = replace_tuned_gains(spec, theta)
            return tracking_cost(
                gains, engine, spec, kinds, worlds_state, start, control_steps=steps
            )

        value, gradient = jax.value_and_grad(cost)(theta)
        return value, gradient

    before = {f"{stage}.{gain}": getattr(stage_gains(spec, stage), gain) for stage, gain in TUNED}
    theta = jnp.log(jnp.array(list(before.values())))
    tuning_worlds, unseen_worlds = simulator.worlds(0), simulator.worlds(worlds)
    start, unseen_start = simulator.reset(tuning_worlds), simulator.reset(unseen_worlds)
    start_s = time.perf_counter()
    compiled = evaluate.lower(theta, simulator.fleet, tuning_worlds, start).compile()
    compile_s = time.perf_counter() - start_s
    first, _ = compiled(theta, simulator.fleet, unseen_worlds, unseen_start)
    start_s = time.perf_counter()
    costs, theta = _descend(
        lambda theta: compiled(theta, simulator.fleet, tuning_worlds, start),
        theta,
        iterations,
        rate,
    )
    tune_s = time.perf_counter() - start_s
    last, _ = compiled(theta, simulator.fleet, unseen_worlds, unseen_start)
    numbers = [float(x) for x in jnp.exp(theta)]
    return TuningResult(
        before=before,
        after=dict(zip(before, numbers, strict=True)),
        costs_m2=costs,
        unseen_m2=(float(first), float(last)),
        compile_s=compile_s,
        tune_s=tune_s,
    )


def stage_gains(spec: SimSpec, stage: str) -> object:
    """Return the gains of a stage of the controllers.

    Raises:
        ConfigError: the controllers have no such stage.
    """
    names = [stage_spec.name for stage_spec in spec.stages]
    if stage not in names:
        raise ConfigError(
            f"stage {stage!r}: what is tuned is the cascade, and the scenario's controllers are "
            + ", ".join(names)
        )
    return spec.gains[names.index(stage)]


def replace_tuned_gains(spec: SimSpec, theta: jax.Array) -> StackGains:
    """Return the gains of all stages, with those in `TUNED` replaced by exp(theta) [5]."""
    tuned: dict[str, dict[str, jax.Array]] = {}
    for i, (stage, gain) in enumerate(TUNED):
        tuned.setdefault(stage, {})[gain] = jnp.exp(theta[i])
    return tuple(
        replace(gains, **tuned.get(stage.name, {}))
        for stage, gains in zip(spec.stages, spec.gains, strict=True)
    )


def _descend(
    evaluate: Callable[[jax.Array], tuple[jax.Array, jax.Array]],
    theta: jax.Array,
    iterations: int,
    rate: float,
) -> tuple[list[float], jax.Array]:
    """Descend by Adam (Kingma and Ba 2015) with a rate that falls to zero.

    Return costs by iteration.
    """
    mean, square = jnp.zeros_like(theta), jnp.zeros_like(theta)
    slow, slower = ADAM_DECAY
    costs = []
    for i in range(iterations):
        cost, gradient = evaluate(theta)
        costs.append(float(cost))
        mean = slow * mean + (1 - slow) * gradient
        square = slower * square + (1 - slower) * gradient**2
        unbiased = mean / (1 - slow ** (i + 1))
        scale = jnp.sqrt(square / (1 - slower ** (i + 1))) + 1e-12
        theta = theta - rate * (1 - i / iterations) * unbiased / scale
    return costs, theta


def main() -> None:
    """Tune the gains of a scenario, and print them before and after."""
    result = tyro.cli(tune)
    print(f"compiled in {result.compile_s:.0f} s, tuned in {result.tune_s:.1f} s")
    for name, before in result.before.items():
        print(f"{name}: {before:.3g} -> {result.after[name]:.3g}")
    rms = [1e2 * cost**0.5 for cost in result.unseen_m2]
    print(f"root mean square tracking error, other worlds: {rms[0]:.2f} cm -> {rms[1]:.2f} cm")


if __name__ == "__main__":
    main()
