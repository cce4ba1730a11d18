"""An environment of many worlds in pure JAX: ``reset`` and ``step``, to be jitted and scanned.

A world whose episode ended is replaced in the same step by another one of the bank (Gymnasium's
SAME_STEP): the observation is then that of the new world, ``info["final_obs"]`` that of the old.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Literal

import jax
import jax.numpy as jnp

from angler_mjx.errors import ConfigError
from angler_mjx.learning import actions, observations, rewards
from angler_mjx.learning import bank as banks
from angler_mjx.learning.actions import ActionSpace
from angler_mjx.learning.bank import WorldBank
from angler_mjx.learning.observations import ObservationPart, ObservedState
from angler_mjx.robot.control import stack
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.sim.engines.base import Engine
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.state import Outcome, SimSpec, WorldState
from angler_mjx.sim.world_phases import sensing

type Aim = Literal["goal", "start"]
"""What robots are rewarded for being near to: their goals, or the poses that they start at."""

OBSERVE = ("velocity", "upright", "goal", "heading")


@dataclass(frozen=True, kw_only=True, eq=False)
class EnvironmentRules:
    """What is fixed while an environment is compiled."""

    spec: SimSpec
    engine: Engine
    action: ActionSpace
    parts: tuple[ObservationPart, ...]
    weights: tuple[tuple[str, float], ...]
    aim: Aim
    horizon: int
    """Control steps of an episode."""
    action_repeat: int = 1
    """Control steps of one step of the environment."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class EnvState:
    """What changes from step to step; [W] leads but in ``key``."""

    flight: WorldState
    row: jax.Array
    """int32 [W] which world of the bank each is."""
    action: jax.Array
    """[W, R, size] the last one, from -1 to 1; zeros at the beginning of an episode."""
    key: jax.Array
    """Of the worlds that come."""


type Stepped = tuple[EnvState, jax.Array, jax.Array, jax.Array, jax.Array, dict[str, Any]]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FleetEnv:
    """An environment; a pytree, so that its bank is an argument of compiled functions.

    ``jax.jit(FleetEnv.step)(env, state, action)`` compiles once. Where a function of one's own
    closes over an environment, its bank is a constant of the program: pass it in if it is large.
    """

    bank: WorldBank
    fleet: Fleet
    observed: jax.Array
    """[B, R, size] what is seen of each world of the bank at its beginning."""
    rules: EnvironmentRules = field(metadata={"static": True})
    worlds: int = field(metadata={"static": True})

    @property
    def robots(self) -> int:
        """In each world."""
        return int(self.observed.shape[1])

    @property
    def action_shape(self) -> tuple[int, int, int]:
        """[world, robot, number]."""
        return self.worlds, self.robots, self.rules.action.size

    @property
    def observation_shape(self) -> tuple[int, int, int]:
        """[world, robot, number]."""
        return self.worlds, self.robots, int(self.observed.shape[2])

    def reset(self, key: jax.Array | None = None) -> tuple[EnvState, jax.Array]:
        """All worlds at t = 0.

        Args:
            key: draws which worlds of the bank; left out, they are its first, and those that come
                are drawn by the key of 0.

        Returns:
            The state, and observations [W, R, size].
        """
        begun: tuple[EnvState, jax.Array] = _begin(self, key)
        return begun

    def step(self, state: EnvState, action: jax.Array) -> Stepped:
        """One step of all worlds; those that end begin anew as others.

        It is ``action_repeat`` control steps long, all with one action.

        Args:
            state: from `reset` or the step before.
            action: [W, R, size], clipped to -1 to 1. A robot whose action holds a number that is
                not finite ends as `diverged` in this step, with a finite reward.

        Returns:
            The state, observations [W, R, size], rewards [W, R], whether each world terminated
            (all its robots' episodes have an outcome) or was truncated (the horizon is over
            before) bool [W], and info: ``final_obs`` [W, R, size], of worlds that go on the same as
            the observations; ``reward_terms`` by name [W, R]; of the world before any replacing
            ``outcome`` int32 [W, R], ``energy_j`` [W, R], ``aim_distance_m`` [W, R], ``time_s``
            [W], ``row`` int32 [W]; ``clipped`` and ``not_finite`` int32 [W, R], how many numbers
            of each action were beyond -1 to 1, or not finite.

        Raises:
            ConfigError: the action has another shape, or, outside of compiled functions, a number
                that is not finite.
        """
        actions.check(action, self.action_shape)
        rules, before = self.rules, state.flight
        raw = jnp.asarray(action, state.action.dtype)
        finite = jnp.isfinite(raw)
        wanted = jnp.where(finite, jnp.clip(raw, -1.0, 1.0), 0.0)
        aim_m, yaw = self._aim(state.row)
        scaled = wanted * jnp.asarray(rules.action.range, wanted.dtype)
        estimate, _ = self._estimate(before, state.row)
        # A robot without a sound action gets no command at all: NaN, which it diverges by.
        sound = jnp.all(finite, axis=-1, keepdims=True)
        scaled = jnp.where(sound, scaled, jnp.nan)
        command = rules.action.make(scaled, estimate, aim_m, yaw)
        after, _ = rules.engine.control_step(
            rules.spec,
            self.fleet,
            self.bank.worlds,
            before,
            command,
            rows=state.row,
            laid=self.bank.laid,
            steps=rules.action_repeat,
        )
        after = _with_finite_energy(after, before)
        reward, terms = rewards.of(
            rules.weights,
            rewards.RewardStep(
                before=before,
                after=after,
                aim_m=aim_m,
                aim_yaw_rad=yaw,
                last=state.action,
                action=wanted,
                dt_s=rules.spec.control_dt_s * rules.action_repeat,
            ),
        )
        seen = self._see(after, state.row, wanted)
        terminated = jnp.all(after.tally.outcome != Outcome.RUNNING, axis=1)
        truncated = (after.step >= rules.horizon) & ~terminated
        now = EnvState(flight=after, row=state.row, action=wanted, key=state.key)
        now, observation = self._replace(now, seen, terminated | truncated)
        info = {
            "final_obs": seen,
            "reward_terms": terms,
            "outcome": after.tally.outcome,
            "energy_j": after.tally.energy_j,
            "aim_distance_m": jnp.sqrt(jnp.sum((after.vehicles.p - aim_m) ** 2, axis=-1)),
            "time_s": after.step * rules.spec.control_dt_s,
            "row": state.row,
            "clipped": jnp.sum(finite & (jnp.abs(raw) > 1.0), axis=-1, dtype=jnp.int32),
            "not_finite": jnp.sum(~finite, axis=-1, dtype=jnp.int32),
        }
        return now, observation, reward, terminated, truncated, info

    def _draw(self, key: jax.Array) -> jax.Array:
        row: jax.Array = jax.random.randint(key, (self.worlds,), 0, self.bank.count, jnp.int32)
        return row

    def _replace(
        self, state: EnvState, seen: jax.Array, ended: jax.Array
    ) -> tuple[EnvState, jax.Array]:
        """Put worlds of the bank in the place of those that ended [W]."""

        def put() -> tuple[EnvState, jax.Array]:
            key, now = jax.random.split(state.key)
            row = self._draw(now)
            fresh = EnvState(
                flight=self.bank.begin(row), row=row, action=jnp.zeros_like(state.action), key=key
            )

            def choose(new: jax.Array, old: jax.Array) -> jax.Array:
                return jnp.where(ended.reshape(-1, *(1,) * (old.ndim - 1)), new, old)

            kept = EnvState(flight=state.flight, row=state.row, action=state.action, key=key)
            both = jax.tree.map(choose, _of_worlds(fresh), _of_worlds(kept))
            after_key = jnp.where(jnp.any(ended), key, state.key)
            after = EnvState(flight=both[0], row=both[1], action=both[2], key=after_key)
            return after, choose(self.observed[row], seen)

        def if_any() -> tuple[EnvState, jax.Array]:
            both: tuple[EnvState, jax.Array] = jax.lax.cond(
                jnp.any(ended), put, lambda: (state, seen)
            )
            return both

        # A branch costs a GPU more than the copies that it saves.
        after: tuple[EnvState, jax.Array] = jax.lax.platform_dependent(cuda=put, default=if_any)
        return after

    def _aim(self, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
        there = self.bank.worlds.environment
        place = there.goal_m if self.rules.aim == "goal" else there.start_m
        return place[rows], there.start_yaw_rad[rows]

    def _estimate(self, state: WorldState, rows: jax.Array) -> tuple[Any, Any]:
        """Return the robots' own motion and the current [W, R, 3], m/s in W, at a state's time.

        Both are the truth, or what the instruments of that time give: the same that the
        controllers use in the control step that begins with this state.
        """
        t = state.step * self.rules.spec.control_dt_s
        flow = observations.flow_at(self.bank.worlds, rows, state.vehicles.p, t)
        if not self.rules.spec.instrumented:
            return state.vehicles, flow
        worlds = jax.tree.map(lambda leaf: leaf[rows], self.bank.worlds)
        read = jax.vmap(partial(sensing.step, self.rules.spec))
        _, belief = read(worlds, state.senses, state.step, state.vehicles, flow)
        return belief, belief.flow

    def _see(self, state: WorldState, rows: jax.Array, action: jax.Array) -> jax.Array:
        aim_m, yaw = self._aim(rows)
        told, flow = self._estimate(state, rows)
        sight = ObservedState(
            worlds=self.bank.worlds,
            rows=rows,
            state=state,
            told=told,
            flow=flow,
            aim_m=aim_m,
            aim_yaw_rad=yaw,
            action=action,
        )
        return observations.see(self.rules.parts, sight)


def _with_finite_energy(after: WorldState, before: WorldState) -> WorldState:
    """Return the state with the energy of before where a command that is no number made it NaN."""
    energy = jnp.where(
        jnp.isfinite(after.tally.energy_j), after.tally.energy_j, before.tally.energy_j
    )
    return replace(after, tally=replace(after.tally, energy_j=energy))


@jax.jit
def _begin(env: FleetEnv, key: jax.Array | None) -> tuple[EnvState, jax.Array]:
    """See `FleetEnv.reset`; compiled, so that its arrays lie where those of `step` do."""
    if key is None:
        key, row = jax.random.key(0), jnp.arange(env.worlds, dtype=jnp.int32) % env.bank.count
    else:
        key, now = jax.random.split(key)
        row = env._draw(now)
    action = jnp.zeros(env.action_shape, env.observed.dtype)
    state = EnvState(flight=env.bank.begin(row), row=row, action=action, key=key)
    return state, env.observed[row]


def _of_worlds(state: EnvState) -> tuple[WorldState, jax.Array, jax.Array]:
    return state.flight, state.row, state.action


def make(
    simulator: Simulator,
    *,
    worlds: int,
    bank: int | WorldBank | None = None,
    action: str = "twist",
    scale: tuple[float, ...] | None = None,
    observe: Sequence[str] = OBSERVE,
    reward: Mapping[str, float] | None = None,
    aim: Aim = "goal",
    horizon: int | None = None,
    seed: int | None = None,
    action_repeat: int = 1,
) -> FleetEnv:
    """An environment over a simulator.

    Args:
        simulator: with one device and without a policy.
        worlds: that fly side by side.
        bank: worlds to draw beforehand, twice ``worlds`` if left out; or those that were drawn.
        action: one of `actions.KINDS`.
        scale: what 1 stands for in each number of the action.
        observe: parts of `observations.PARTS`.
        reward: weights of terms of `rewards.TERMS`; `rewards.DEFAULT` if left out.
        aim: what robots are to be near to.
        horizon: control steps of an episode; the scenario's if left out.
        seed: of the bank, instead of the scenario's.
        action_repeat: control steps that an action is held for; the horizon is a whole number of
            these.

    Raises:
        ConfigError: a name or number is none that there is, no stage of the controllers takes the
            action, the current is asked for where nobody tells it, or the simulator has several
            devices or a policy.
    """
    if simulator.devices != 1 or simulator.policy is not None:
        instead = ""
        if simulator.scenario.keeps_order_by_auto:
            instead = (
                "; the order of passing is kept by default in this team: load the scenario with "
                'execution={"order": "free"}'
            )
        raise ConfigError(
            "an environment wants a simulator with devices=1 and no policy: the agent is the "
            f"policy{instead}"
        )
    most = simulator.scenario.time.control_steps
    steps = most if horizon is None else horizon
    if aim not in ("goal", "start"):
        raise ConfigError(f"aim = {aim!r}: there is goal, start")
    for name, value in (
        ("worlds", worlds),
        ("horizon", steps),
        ("action_repeat", action_repeat),
    ):
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise ConfigError(f"{name} = {value!r}: give a whole number above 0")
    if steps > most:
        raise ConfigError(f"horizon = {steps}: the scenario's is {most} control steps; give less")
    if steps % action_repeat:
        raise ConfigError(
            f"action_repeat = {action_repeat}: the horizon of {steps} control steps is no whole "
            "number of these; give one that divides it, or another horizon"
        )
    thrusters = int(simulator.fleet.control.vehicle.B.shape[-1])
    kind = actions.named(action, thrusters, scale)
    if kind.command is not None:
        stack.entry(simulator.spec.stages, kind.command)
    parts = observations.chosen(observe, kind.size)
    tells_current = not simulator.spec.instrumented or stack.wants_flow(simulator.spec.stages)
    if "current" in observe and not tells_current:
        raise ConfigError(
            "observe: 'current' is told by nobody here: robots have instruments, and their "
            "controllers do not ask for it; leave it out"
        )
    weights = rewards.weighed(rewards.DEFAULT if reward is None else reward)
    if not isinstance(bank, WorldBank):
        bank = banks.draw(simulator, 2 * worlds if bank is None else bank, seed=seed)
    rules = EnvironmentRules(
        spec=simulator.spec,
        engine=simulator.engine,
        action=kind,
        parts=parts,
        weights=weights,
        aim=aim,
        horizon=steps,
        action_repeat=action_repeat,
    )
    env = FleetEnv(
        bank=bank,
        fleet=banks.loose(simulator.fleet),
        observed=jnp.zeros((bank.count, *bank.worlds.variant.shape[1:], 0)),
        rules=rules,
        worlds=worlds,
    )
    return _with_first_observations(env)


def _with_first_observations(env: FleetEnv) -> FleetEnv:
    def look(env: FleetEnv) -> jax.Array:
        rows = jnp.arange(env.bank.count, dtype=jnp.int32)
        still = jnp.zeros((env.bank.count, env.robots, env.rules.action.size))
        return env._see(env.bank.begun, rows, still)

    seen = jax.jit(look)(env)
    return FleetEnv(
        bank=env.bank, fleet=env.fleet, observed=seen, rules=env.rules, worlds=env.worlds
    )
