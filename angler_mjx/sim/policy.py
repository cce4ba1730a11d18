"""Policies: a function of what the robots of a world know, called in every control step.

A policy stands where a path or a command from outside stands otherwise: it commands all robots of a
world together, at any level that the controllers take, from a JointTrajectory down to the
thrusters' signals. It is a pytree: its parameters are leaves, so that learned weights are arguments
of the compiled programs and have derivatives; what is static must be hashable.
"""

import hashlib
import inspect
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from operator import attrgetter
from typing import TYPE_CHECKING, Any, ClassVar

import jax
import jax.numpy as jnp
import numpy as np

from angler_mjx._moved import renamed as _renamed
from angler_mjx._moved import renamed_attribute
from angler_mjx.errors import ConfigError
from angler_mjx.periods import every_n_steps
from angler_mjx.robot.control import command_checks, stack
from angler_mjx.robot.control.commands import GripReading
from angler_mjx.robot.control.mixed import MixedCommand
from angler_mjx.robot.control.plans import Plan
from angler_mjx.robot.control.stack import Command, ControlParams, Stages
from angler_mjx.robot.vehicles.params import joint_names
from angler_mjx.sim.information import (
    LEVELS,
    CurrentInformation,
    Information,
    ObstacleInformation,
)
from angler_mjx.sim.record import Belief
from angler_mjx.user_classes import USER_MODULE
from angler_mjx.world.acoustics.channel import HeardRobots, init_heard
from angler_mjx.world.rock.grid import Grid
from angler_mjx.world.routes import Routes

RESET_STEP = 2**32 - 1
"""What a world's key is folded with for `Policy.reset`; no step has this number."""

MAX_AHEAD_S = 86400
"""Farthest ahead that motion is told."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PolicyInput:
    """Information of the robots of one world; [R] leads.

    Motion is the estimate of each robot, which is the truth only where the scenario says so.
    Outcomes and other worlds are not in it. Earlier commands are for the policy to keep. Rock,
    obstacles and current are None unless the policy has `Policy.information`.
    """

    belief: Belief
    """Estimate of each robot's motion; ``flow`` is the current, where the estimate has it."""
    time_s: jax.Array
    """[] since the start."""
    goal_m: jax.Array
    """[R, 3] in W."""
    path: Plan
    """As the planner made them, before the start."""
    params: ControlParams
    """Vehicles as the controllers model them."""
    grid: Grid | None = None
    """Rock."""
    floor_z_m: jax.Array | None = None
    """[] height of the sea floor."""
    obstacles: ObstacleInformation | None = None
    """Bodies that are not cells, as far as they may be known now; their times run from now on."""
    current: CurrentInformation | None = None
    """The water's motion, as far as it may be known now; its times run from now on."""
    others: HeardRobots | None = None
    """Packets that robots received from each other; None without acoustics."""
    routes: Routes | None = None
    """Routes to the positions of the world; None without `Policy.routes_margin_m`."""
    goal_index: jax.Array | None = None
    """int32 [R] index of the goal of each robot among the routes; -1: none, it stays."""
    joint_position: jax.Array | None = None
    """[R, J] positions of the joints of arms, rad or m, as encoders show them; without meaning for
    a robot without an arm. None where no robot has one."""
    grip: GripReading | None = None
    """[R] leads; measured by the grips of robots that hold a body, None where none do."""

    if not TYPE_CHECKING:  # a checker would take every attribute for one

        def __getattr__(self, name: str) -> object:
            """Return a field by its name before 0.2, with a DeprecationWarning."""
            return renamed_attribute(self, name, {"place": "goal_index"})


class Policy(ABC):
    """Commands all robots of a world; a frozen dataclass registered with ``jax.tree_util``."""

    renamed_attributes: ClassVar[Mapping[str, str]] = {
        "flown": "executed_plans",
        "knows": "information",
        "looks": "observation_period",
        "says": "payload",
    }
    """Attributes by their names before 0.2; policies that have those work until 1.0."""
    period: int = 1
    """Control steps from one call of `act` to the next; its command holds until then."""
    information: Information | None = None
    """Information levels of rock, obstacles and current at each call; None: they are not passed."""
    observation_period: int = 1
    """Control steps from one observation of rock, obstacles and current to the next; no obstacle
    exists in the steps between. For policies that look far ahead at a high cost."""
    ahead_s: float = 0.0
    """Time [s] after a call over which obstacles have true and predicted motion."""
    routes_margin_m: float | None = None
    """Margin [m] beside the widest robot's radius of the routes that worlds are sampled with; None:
    worlds have no routes."""

    def __init_subclass__(cls, **arguments: object) -> None:
        """Accept attributes and methods by their names before 0.2."""
        super().__init_subclass__(**arguments)
        members = {**inspect.get_annotations(cls), **cls.__dict__}
        for old, new in cls.renamed_attributes.items():
            if old not in members or new in members:
                continue
            warnings.warn(
                f"policy {cls.__name__}: {old} is {new} since 0.2; the old name works until 1.0",
                DeprecationWarning,
                stacklevel=2,
            )
            is_method = inspect.isfunction(members[old])
            setattr(cls, new, members[old] if is_method else property(attrgetter(old)))

    if not TYPE_CHECKING:  # a checker would take every attribute for one

        def __getattr__(self, name: str) -> object:
            """Return an attribute by its name before 0.2, with a DeprecationWarning."""
            return renamed_attribute(self, name, type(self).renamed_attributes)

    def reset(self, inputs: PolicyInput, key: jax.Array) -> object:
        """Memory at t = 0: a pytree of arrays.

        Args:
            inputs: what the robots know then.
            key: of this world's policy.
        """
        return ()

    def payload(self, carry: Any) -> object:
        """What robots put into their packets beside where they are, where they talk by acoustics.

        Args:
            carry: memory.

        Returns:
            A pytree of arrays, [R] leading, which others find in ``inputs.others.payload``; None if
            nothing.
        """
        return None

    def executed_plans(self, carry: Any, path: Plan) -> tuple[Plan, jax.Array] | None:
        """Return the plans that the robots fly, and their times along them.

        Args:
            carry: memory, after the step.
            path: [R] planned before the start.

        Returns:
            Plans [R] and times [R] s. A robot arrives on the last approach of its plan to its goal.
            None where `act` commands plans themselves, or where the distance to the goal alone
            counts.
        """
        return None

    @abstractmethod
    def act(
        self, carry: Any, inputs: PolicyInput, key: jax.Array, step: jax.Array
    ) -> tuple[object, Command | MixedCommand]:
        """Command the robots.

        Args:
            carry: memory.
            inputs: what the robots know.
            key: of this world and step.
            step: int32 [] control steps taken.

        Returns:
            The memory, and a command of any type that a stage of the controllers takes, [R]
            leading in all its arrays.
        """


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class PolicyMemory:
    """What a world keeps of its policy."""

    carry: object
    command: Command | MixedCommand | None
    """That holds until the next call; None for a policy that is called in every step."""


def begin_policy(
    policy: Policy, stages: Stages, policy_key: jax.Array | None, inputs: PolicyInput
) -> PolicyMemory:
    """Memory of a policy at t = 0.

    Args:
        policy: of the world.
        stages: of the controllers that it commands.
        policy_key: uint32 [2] of the world.
        inputs: what the robots know then.

    Raises:
        ConfigError: no stage takes what it commands, or not in these shapes, or its memory changes
            its shape, or its period is no whole number above 0, or the world has no key for it.
    """
    check_information(policy)
    name, period = type(policy).__name__, policy.period
    if not isinstance(period, int) or isinstance(period, bool) or period < 1:
        raise ConfigError(f"policy {name}: period = {period!r}; give a whole number above 0")
    key = _wrap_key(policy, policy_key)
    carry = policy.reset(inputs, jax.random.fold_in(key, RESET_STEP))
    if inputs.others is not None:
        inputs = replace(inputs, others=init_heard(inputs.belief.p, policy.payload(carry)))
    step = jax.ShapeDtypeStruct((), jnp.int32)
    after, command = jax.eval_shape(policy.act, carry, inputs, key, step)
    _check_command(name, stages, command, inputs)
    if _list_shapes(carry) != _list_shapes(after):
        raise ConfigError(
            f"policy {name}: act gives a memory of other shapes or types than reset: "
            f"{_list_shapes(after)} instead of {_list_shapes(carry)}"
        )
    held = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), command)
    return PolicyMemory(carry=carry, command=held if period > 1 else None)


def check_information(policy: Policy) -> None:
    """Refuse a policy that asks for what nobody can tell.

    Raises:
        ConfigError: ``information`` is none, or names no level, or ``observation_period`` is no
            whole number above 0, or ``ahead_s`` is no time.
    """
    name, information, ahead = type(policy).__name__, policy.information, policy.ahead_s
    if information is None:
        return
    if not isinstance(information, Information):
        raise ConfigError(
            f"policy {name}: information = {information!r}; give an Information, or None"
        )
    for subject in ("obstacles", "current"):
        if getattr(information, subject) not in LEVELS:
            raise ConfigError(
                f"policy {name}: information.{subject} = {getattr(information, subject)!r}; "
                f"there is {', '.join(LEVELS)}"
            )
    period = policy.observation_period
    if not isinstance(period, int) or isinstance(period, bool) or period < 1:
        raise ConfigError(
            f"policy {name}: observation_period = {period!r}; give a whole number above 0"
        )
    if (
        isinstance(ahead, bool)
        or not isinstance(ahead, int | float)
        or not 0 <= ahead <= MAX_AHEAD_S
    ):
        raise ConfigError(
            f"policy {name}: ahead_s = {ahead!r}; give a time from 0 to {MAX_AHEAD_S} s"
        )


def _wrap_key(policy: Policy, policy_key: jax.Array | None) -> jax.Array:
    if policy_key is None:
        raise ConfigError(
            f"policy {type(policy).__name__}: the worlds were drawn without keys for it; give it "
            "to the Simulator that draws them"
        )
    key: jax.Array = jax.random.wrap_key_data(policy_key)
    return key


def _check_command(
    name: str, stages: Stages, command: Command | MixedCommand, inputs: PolicyInput
) -> None:
    vehicle = inputs.params.vehicle
    lead, thrusters = (1, inputs.goal_m.shape[0]), vehicle.B.shape[-1]
    joints = len(joint_names(vehicle))
    command = jax.tree.map(lambda x: jax.ShapeDtypeStruct((1, *x.shape), x.dtype), command)
    try:
        for part in command.commands if isinstance(command, MixedCommand) else [command]:
            stack.check_command(stages, part, lead, thrusters, joints)
        if isinstance(command, MixedCommand):
            command_checks.check_choice(command, lead, joints)
    except ConfigError as error:
        raise ConfigError(f"policy {name}: {error}") from None


def require_alike(policy: Policy, other: Policy) -> None:
    """Refuse a policy that is not another one with other numbers.

    Raises:
        ConfigError: it is of another class, static part or shape.
    """
    if _list_shapes(policy) != _list_shapes(other):
        raise ConfigError(
            f"policy {type(other).__name__}: is made otherwise than the simulator's "
            f"{type(policy).__name__}; only the numbers in it may differ"
        )


def describe_policy(policy: Policy) -> dict[str, str]:
    """What tells policies apart: class, static part, and a hash of their numbers."""
    digest = hashlib.sha256()
    leaves, structure = jax.tree.flatten(policy)
    for leaf in leaves:
        values = np.asarray(leaf, jnp.result_type(leaf))  # of JAX's types, as simulators hold it
        digest.update(f"{values.dtype}{values.shape}".encode())
        digest.update(values.tobytes())
    kind = type(policy)
    # A run keeps a copy of a user's file, whose module has another name.
    is_of_file = kind.__module__.startswith(USER_MODULE)
    return {
        "class": kind.__qualname__ if is_of_file else f"{kind.__module__}.{kind.__qualname__}",
        "structure": str(structure),
        "sha256": digest.hexdigest(),
    }


def _list_shapes(tree: object) -> tuple[list[str], jax.tree_util.PyTreeDef]:
    leaves, structure = jax.tree.flatten(tree)
    return [f"{jnp.result_type(leaf)}{list(jnp.shape(leaf))}" for leaf in leaves], structure


def step(
    policy: Policy,
    policy_key: jax.Array | None,
    memory: PolicyMemory,
    inputs: Callable[[], PolicyInput],
    number: jax.Array,
    every: int = 1,
) -> tuple[PolicyMemory, Command | MixedCommand]:
    """One control step of one world.

    Args:
        policy: of the world.
        policy_key: uint32 [2] of the world.
        memory: of the policy.
        inputs: what the robots know, worked out where the policy is called.
        number: int32 [] control steps taken.
        every: what ``number`` is known to be a multiple of.

    Returns:
        The memory, and the command of the robots.
    """
    key = jax.random.fold_in(_wrap_key(policy, policy_key), number)

    def act() -> tuple[object, Command | MixedCommand]:
        return policy.act(memory.carry, inputs(), key, number)

    if policy.period == 1 or memory.command is None:
        carry, command = act()
        return PolicyMemory(carry=carry, command=None), command
    before = memory.carry, memory.command
    carry, command = every_n_steps(policy.period, number, act, lambda: before, every)
    return PolicyMemory(carry=carry, command=command), command


def __getattr__(name: str) -> object:
    """Return what had another name before 0.2."""
    return _renamed(__name__, name)
