"""Environment of many worlds in pure JAX: ``reset`` and ``step``, to be jitted and scanned.

A world whose episode ended is replaced in the same step by another one of the bank (Gymnasium's
SAME_STEP): the observation is then that of the new world, ``info["final_obs"]`` that of the old.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal, TypedDict

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx._moved import renamed as _renamed
from angler_mjx.errors import ConfigError
from angler_mjx.learning import actions, observations, rewards
from angler_mjx.learning import bank as banks
from angler_mjx.learning.actions import ActionSpace, JointRanges, RobotMotion
from angler_mjx.learning.bank import WorldBank
from angler_mjx.learning.observations import ObservationPart, ObservedState
from angler_mjx.robot.control import stack
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.sim import sensing
from angler_mjx.sim.engines.base import Engine
from angler_mjx.sim.fleet import Fleet
from angler_mjx.sim.state import EngineState, Outcome, SimSpec, WorldState

type Aim = Literal["goal", "start"]
"""Target of robots: their goals, or the poses at the start."""

DEFAULT_OBSERVATION = ("velocity", "upright", "goal", "heading")


@dataclass(frozen=True, kw_only=True, eq=False)
class EnvironmentRules:
    """Static configuration of a compiled environment."""

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
    """State of an environment; [W] leads except for ``key``."""

    engine_state: EngineState
    """Of `Engine.pack_state`."""
    row: jax.Array
    """int32 [W] index in the bank of each world."""
    action: jax.Array
    """[W, R, size] last action, from -1 to 1; zeros at the beginning of an episode."""
    key: jax.Array
    """Key of later worlds."""
    engine: Engine = field(metadata={"static": True})

    @property
    def world_state(self) -> WorldState:
        """Return the state of the worlds."""
        return self.engine.unpack_state(self.engine_state)

    def with_world_state(self, world_state: WorldState) -> "EnvState":
        """Return the same with another state of the worlds."""
        return replace(self, engine_state=self.engine.pack_state(world_state))


class StepInfo(TypedDict):
    """Details of a step."""

    final_obs: jax.Array
    """[W, R, size] observation before ended worlds began anew."""
    reward_terms: dict[str, jax.Array]
    """[W, R] by name."""
    outcome: jax.Array
    """int32 [W, R], an `angler_mjx.sim.state.Outcome`."""
    energy_j: jax.Array
    """[W, R]."""
    aim_distance_m: jax.Array
    """[W, R]."""
    time_s: jax.Array
    """[W]."""
    row: jax.Array
    """int32 [W] index in the bank."""
    clipped: jax.Array
    """int32 [W, R] number of action values beyond -1 to 1."""
    not_finite: jax.Array
    """int32 [W, R] number of action values that are no finite numbers."""


type StepResult = tuple[EnvState, jax.Array, jax.Array, jax.Array, jax.Array, StepInfo]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class FleetEnv:
    """Environment; a pytree, so that its bank is an argument of compiled functions.

    ``jax.jit(FleetEnv.step)(env, state, action)`` compiles once. Where a function closes over an
    environment, its bank is a constant of the program: pass it as an argument if it is large.
    """

    bank: WorldBank
    fleet: Fleet
    initial_observation: jax.Array
    """[B, R, size] first observation of each world of the bank."""
    rules: EnvironmentRules = field(metadata={"static": True})
    worlds: int = field(metadata={"static": True})

    @property
    def robots(self) -> int:
        """Return the number of robots of each world."""
        return int(self.initial_observation.shape[1])

    @property
    def action_shape(self) -> tuple[int, int, int]:
        """Return [world, robot, number]."""
        return self.worlds, self.robots, self.rules.action.size

    @property
    def observation_shape(self) -> tuple[int, int, int]:
        """Return [world, robot, number]."""
        return self.worlds, self.robots, int(self.initial_observation.shape[2])

    def reset(self, key: jax.Array | None = None) -> tuple[EnvState, jax.Array]:
        """Start all worlds at t = 0.

        Args:
            key: samples worlds of the bank; left out, they are its first, and later ones are
                sampled by the key of 0.

        Returns:
            The state, and observations [W, R, size].
        """
        result: tuple[EnvState, jax.Array] = _reset(self, key)
        return result

    def step(self, state: EnvState, action: jax.Array) -> StepResult:
        """Advance all worlds by one step; ended worlds are replaced.

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
        actions.check_actions(action, self.action_shape)
        rules, engine, before = self.rules, self.rules.engine, state.world_state
        raw = jnp.asarray(action, state.action.dtype)
        finite = jnp.isfinite(raw)
        clipped = jnp.where(finite, jnp.clip(raw, -1.0, 1.0), 0.0)
        aim_m, yaw = self._aim_pose(state.row)
        scaled = clipped * jnp.asarray(rules.action.range, clipped.dtype)
        estimate, _ = self._estimate_motion(before, state.row)
        # A robot without a sound action gets NaN as command, by which it diverges.
        is_finite = jnp.all(finite, axis=-1, keepdims=True)
        scaled = jnp.where(is_finite, scaled, jnp.nan)
        command = rules.action.make_command(scaled, estimate, aim_m, yaw)
        engine_state = engine.advance(
            rules.spec,
            self.fleet,
            self.bank.worlds,
            state.engine_state,
            command,
            state.row,
            self.bank.laid,
            rules.action_repeat,
        )
        after = _with_finite_energy(engine.unpack_state(engine_state), before)
        engine_state = engine.replace_energy(engine_state, after.tally.energy_j)
        reward, terms = rewards.compute_reward(
            rules.weights,
            rewards.RewardStep(
                before=before,
                after=after,
                aim_m=aim_m,
                aim_yaw_rad=yaw,
                last_action=state.action,
                action=clipped,
                dt_s=rules.spec.control_dt_s * rules.action_repeat,
            ),
        )
        final_observation = self._observe(after, state.row, clipped)
        terminated = jnp.all(after.tally.outcome != Outcome.RUNNING, axis=1)
        truncated = (after.step >= rules.horizon) & ~terminated
        next_state = replace(state, engine_state=engine_state, action=clipped)
        next_state, observation = self._replace_ended(
            next_state, final_observation, terminated | truncated
        )
        info: StepInfo = {
            "final_obs": final_observation,
            "reward_terms": terms,
            "outcome": after.tally.outcome,
            "energy_j": after.tally.energy_j,
            "aim_distance_m": jnp.sqrt(jnp.sum((after.vehicles.p - aim_m) ** 2, axis=-1)),
            "time_s": after.step * rules.spec.control_dt_s,
            "row": state.row,
            "clipped": jnp.sum(finite & (jnp.abs(raw) > 1.0), axis=-1, dtype=jnp.int32),
            "not_finite": jnp.sum(~finite, axis=-1, dtype=jnp.int32),
        }
        return next_state, observation, reward, terminated, truncated, info

    def _sample_rows(self, key: jax.Array) -> jax.Array:
        """Sample a world of the bank for each world: int32 [W]."""
        row = jax.random.randint(key, (self.worlds,), 0, self.bank.count, jnp.int32)
        # XLA would sample again for every number of a state: 30 us of 148 us a step on an H200.
        sampled: jax.Array = jax.lax.optimization_barrier(row)
        return sampled

    def _replace_ended(
        self, state: EnvState, observation: jax.Array, ended: jax.Array
    ) -> tuple[EnvState, jax.Array]:
        """Replace ended worlds [W] by worlds of the bank."""

        def replace_worlds() -> tuple[EnvState, jax.Array]:
            key, row_key = jax.random.split(state.key)
            row = self._sample_rows(row_key)
            of_world = ended[:, None, None]
            after = replace(
                state,
                engine_state=self.rules.engine.replace_states(
                    state.engine_state, ended, self.bank.packed_state, row
                ),
                row=jnp.where(ended, row, state.row),
                action=jnp.where(of_world, 0.0, state.action),
                key=jnp.where(jnp.any(ended), key, state.key),
            )
            return after, jnp.where(of_world, self.initial_observation[row], observation)

        def replace_if_any() -> tuple[EnvState, jax.Array]:
            selected: tuple[EnvState, jax.Array] = jax.lax.cond(
                jnp.any(ended), replace_worlds, lambda: (state, observation)
            )
            return selected

        # A branch costs a GPU more than the copies that it saves.
        after: tuple[EnvState, jax.Array] = jax.lax.platform_dependent(
            cuda=replace_worlds, default=replace_if_any
        )
        return after

    def _aim_pose(self, rows: jax.Array) -> tuple[jax.Array, jax.Array]:
        environment = self.bank.worlds.environment
        aim_m = environment.goal_m if self.rules.aim == "goal" else environment.start_m
        return aim_m[rows], environment.start_yaw_rad[rows]

    def _estimate_motion(self, state: WorldState, rows: jax.Array) -> tuple[RobotMotion, jax.Array]:
        """Return the robots' own motion and the current [W, R, 3], m/s in W, at a state's time.

        Both are the truth, or readings of the instruments at that time: the values that the
        controllers use in the control step that begins with this state.
        """
        t = state.step * self.rules.spec.control_dt_s
        flow = observations.current_at(self.bank.worlds, rows, state.vehicles.p, t)
        if not self.rules.spec.instrumented:
            return state.vehicles, flow
        worlds = jax.tree.map(lambda leaf: leaf[rows], self.bank.worlds)
        read = jax.vmap(partial(sensing.step, self.rules.spec))
        _, belief = read(worlds, state.senses, state.step, state.vehicles, flow)
        assert belief.flow is not None  # given a current, the instruments estimate one
        return belief, belief.flow

    def _observe(self, state: WorldState, rows: jax.Array, action: jax.Array) -> jax.Array:
        aim_m, yaw = self._aim_pose(rows)
        estimate, flow = self._estimate_motion(state, rows)
        observed = ObservedState(
            worlds=self.bank.worlds,
            rows=rows,
            state=state,
            estimate=estimate,
            flow=flow,
            aim_m=aim_m,
            aim_yaw_rad=yaw,
            action=action,
        )
        return observations.build_observation(self.rules.parts, observed)


def _with_finite_energy(after: WorldState, before: WorldState) -> WorldState:
    """Return the state with the earlier energy where a command of NaN made it NaN."""
    energy = jnp.where(
        jnp.isfinite(after.tally.energy_j), after.tally.energy_j, before.tally.energy_j
    )
    return replace(after, tally=replace(after.tally, energy_j=energy))


@jax.jit
def _reset(env: FleetEnv, key: jax.Array | None) -> tuple[EnvState, jax.Array]:
    """Reset an environment; compiled, so that its arrays lie on the device of those of `step`."""
    if key is None:
        key, row = jax.random.key(0), jnp.arange(env.worlds, dtype=jnp.int32) % env.bank.count
    else:
        key, row_key = jax.random.split(key)
        row = env._sample_rows(row_key)
    action = jnp.zeros(env.action_shape, env.initial_observation.dtype)
    engine = env.rules.engine
    state = EnvState(
        engine_state=engine.select_states(env.bank.packed_state, row),
        row=row,
        action=action,
        key=key,
        engine=engine,
    )
    return state, env.initial_observation[row]


def _joint_ranges(simulator: Simulator) -> JointRanges | None:
    """Return the limits of the joints of the fleet's arms; None where no vehicle has any."""
    links = simulator.fleet.control.vehicle.links
    if links is None:
        return None
    # Of the first vehicle with links; one without has some without mass.
    first = int(np.argmax(np.asarray(links.mass_kg).sum(axis=-1) > 0.0))
    lower, upper = (np.asarray(limits)[first].tolist() for limits in (links.lower, links.upper))
    return JointRanges(lower=tuple(lower), upper=tuple(upper))


def make_env(
    simulator: Simulator,
    *,
    worlds: int,
    bank: int | WorldBank | None = None,
    action: str = "twist",
    scale: tuple[float, ...] | None = None,
    observe: Sequence[str] = DEFAULT_OBSERVATION,
    reward: Mapping[str, float] | None = None,
    aim: Aim = "goal",
    horizon: int | None = None,
    seed: int | None = None,
    action_repeat: int = 1,
) -> FleetEnv:
    """Make an environment over a simulator.

    Args:
        simulator: with one device and without a policy.
        worlds: number of worlds in the batch.
        bank: number of worlds to sample, twice ``worlds`` if left out; or a bank of sampled worlds.
        action: one of `actions.KINDS`, or `actions.WHOLE_BODY` for vehicles with joints.
        scale: value of 1 in each number of the action.
        observe: parts of `observations.PARTS`.
        reward: weights of terms of `rewards.TERMS`; `rewards.DEFAULT_WEIGHTS` if left out.
        aim: target of robots.
        horizon: control steps of an episode; the scenario's if left out.
        seed: seed of the bank; the scenario's if left out.
        action_repeat: control steps that an action is held for; the horizon is a whole number of
            these.

    Raises:
        ConfigError: a name is unknown or a number out of range, no stage of the controllers takes
            the action, the current is observed where no instrument measures it, or the simulator
            has several devices or a policy.
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
    max_steps = simulator.scenario.time.control_steps
    steps = max_steps if horizon is None else horizon
    if aim not in ("goal", "start"):
        raise ConfigError(f"aim = {aim!r}: there is goal, start")
    for name, value in (
        ("worlds", worlds),
        ("horizon", steps),
        ("action_repeat", action_repeat),
    ):
        if not isinstance(value, int) or isinstance(value, bool) or value < 1:
            raise ConfigError(f"{name} = {value!r}: give a whole number above 0")
    if steps > max_steps:
        raise ConfigError(
            f"horizon = {steps}: the scenario's is {max_steps} control steps; give less"
        )
    if steps % action_repeat:
        raise ConfigError(
            f"action_repeat = {action_repeat}: the horizon of {steps} control steps is no whole "
            "number of these; give one that divides it, or another horizon"
        )
    thrusters = int(simulator.fleet.control.vehicle.B.shape[-1])
    joints = _joint_ranges(simulator)
    kind = actions.build_action_space(action, thrusters, scale, joints)
    if kind.command is not None:
        stack.find_entry(simulator.spec.stages, kind.command)
    parts = observations.select_parts(
        observe, kind.size, 0 if joints is None else len(joints.lower)
    )
    tells_current = not simulator.spec.instrumented or stack.wants_flow(simulator.spec.stages)
    if "current" in observe and not tells_current:
        raise ConfigError(
            "observe: 'current' is not available: robots have instruments, and their "
            "controllers do not use the current; leave it out"
        )
    weights = rewards.check_weights(rewards.DEFAULT_WEIGHTS if reward is None else reward)
    if not isinstance(bank, WorldBank):
        bank = banks.sample_worlds(simulator, 2 * worlds if bank is None else bank, seed=seed)
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
        fleet=banks.to_default_device(simulator.fleet),
        initial_observation=jnp.zeros((bank.count, *bank.worlds.variant.shape[1:], 0)),
        rules=rules,
        worlds=worlds,
    )
    return _with_first_observations(env)


def _with_first_observations(env: FleetEnv) -> FleetEnv:
    def observe_initial(env: FleetEnv) -> jax.Array:
        rows = jnp.arange(env.bank.count, dtype=jnp.int32)
        zero_action = jnp.zeros((env.bank.count, env.robots, env.rules.action.size))
        return env._observe(env.bank.initial_state, rows, zero_action)

    observation = jax.jit(observe_initial)(env)
    return FleetEnv(
        bank=env.bank,
        fleet=env.fleet,
        initial_observation=observation,
        rules=env.rules,
        worlds=env.worlds,
    )


def __getattr__(name: str) -> object:
    """Return a name of 0.1, with a DeprecationWarning."""
    return _renamed(__name__, name)
