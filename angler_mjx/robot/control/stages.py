"""The stages that a stack can be made of, and the stacks that have names."""

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from functools import cache
from types import ModuleType
from typing import TYPE_CHECKING, Any

import jax

from angler_mjx.errors import ConfigError
from angler_mjx.robot.control import allocation, stack
from angler_mjx.robot.control.commands import (
    BodyTwist,
    BodyWrench,
    Estimate,
    PoseTarget,
    ThrusterPwm,
    TrackingTarget,
)
from angler_mjx.robot.control.commands.joint_trajectory import JointTrajectory
from angler_mjx.robot.control.commands.trajectory import Trajectory
from angler_mjx.robot.control.commands.whole_body import EndEffectorTarget, WholeBodyCommand
from angler_mjx.robot.control.laws import (
    admittance,
    aitsm,
    cargo_wrench,
    computed_torque,
    follow,
    glide,
    grip_moment,
    guided,
    ismc,
    leader_follower,
    link_wrench,
    los,
    pid_pose,
    pid_velocity,
    pose,
    tracking,
    velocity,
    whole_body,
)
from angler_mjx.robot.control.laws.ardusub import law as ardusub
from angler_mjx.robot.control.stack import Command, StackGains, Stage, StageInput, Stages
from angler_mjx.user_classes import is_class_of_file, load_class

if TYPE_CHECKING:
    from _typeshed import DataclassInstance

_PATHS = (Trajectory, JointTrajectory)
_POSES = (PoseTarget, TrackingTarget)


def _of_law(
    name: str,
    law: ModuleType,
    gains: type,
    takes: tuple[type, ...],
    gives: type,
    *,
    flow: bool = False,
    realised: bool = False,
    grip: bool = False,
    sway: bool = False,
    fins: bool = False,
    glides: bool = False,
    progress: Callable[..., jax.Array] | None = None,
) -> Stage:
    """A stage of a law that knows its vehicle and the water."""

    def step(
        gains: "DataclassInstance", carry: object, inputs: StageInput, command: Command
    ) -> tuple[object, Command]:
        more: dict[str, object] = {}
        if flow:
            more["flow"] = inputs.estimate.flow
        if realised:
            more["realised"] = inputs.realised
        after: tuple[object, Command] = law.step(
            gains,
            inputs.params.vehicle_model,
            carry,
            inputs.estimate,
            command,
            inputs.dt,
            inputs.density,
            inputs.gravity,
            **more,
        )
        return after

    def reset(estimate: Estimate, _: jax.Array) -> object:
        return law.reset(estimate)

    return Stage(
        name=name,
        takes=takes,
        gives=gives,
        step=step,
        reset=reset,
        gains=gains,
        check=law.check,
        wants_flow=flow,
        wants_realised=realised,
        wants_grip=grip,
        wants_sway=sway,
        flies_by_fins=fins,
        glides=glides,
        progress=progress,
    )


def _no_memory(_: Estimate, __: jax.Array) -> tuple[()]:
    """Memory of a stage that has none."""
    return ()


def _step_follow(
    gains: follow.FollowGains,
    carry: follow.FollowCarry,
    inputs: StageInput,
    command: Trajectory | JointTrajectory,
) -> tuple[follow.FollowCarry, PoseTarget]:
    return follow.step(gains, carry, inputs.estimate, command, inputs.dt)


def _step_track(
    gains: follow.FollowGains,
    carry: follow.FollowCarry,
    inputs: StageInput,
    command: Trajectory | JointTrajectory,
) -> tuple[follow.FollowCarry, TrackingTarget]:
    return follow.track_target(gains, carry, inputs.estimate, command, inputs.dt)


def _plan_clock(carry: follow.FollowCarry, _: object) -> jax.Array:
    return carry.clock_s


def _step_pose(
    gains: pose.PoseGains,
    carry: tuple[()],
    inputs: StageInput,
    command: PoseTarget | TrackingTarget,
) -> tuple[tuple[()], BodyTwist]:
    params = inputs.params
    return carry, pose.step(
        gains, params.vehicle_model, params.cruise_speed_mps, inputs.estimate, command
    )


def _allocation_stage(name: str, allocate: Callable[..., ThrusterPwm]) -> Stage:
    """A stage that allocates a wrench."""

    def step(
        _: object, carry: tuple[()], inputs: StageInput, command: BodyWrench
    ) -> tuple[tuple[()], ThrusterPwm]:
        params = inputs.params.allocation
        pwm = allocate(params, command)
        if params.fins is None:
            return carry, pwm
        speed_mps = inputs.estimate.nu[0]
        return carry, allocation.deflect_fins(params.fins, command, speed_mps, inputs.density, pwm)

    return Stage(name=name, takes=(BodyWrench,), gives=ThrusterPwm, step=step, reset=_no_memory)


def _step_whole_body(
    gains: whole_body.WholeBodyGains,
    carry: whole_body.WholeBodyCarry,
    inputs: StageInput,
    command: EndEffectorTarget | BodyTwist,
) -> tuple[whole_body.WholeBodyCarry, Command]:
    if isinstance(command, BodyTwist):
        if inputs.joints is None:
            return carry, command
        return carry, WholeBodyCommand(base=command, joints=inputs.joints)
    links = inputs.params.vehicle_model.links
    if links is None or inputs.joints is None:
        raise ConfigError("command EndEffectorTarget: no robot of the fleet has links")
    return whole_body.step(gains, links, carry, inputs.estimate, command, inputs.joints, inputs.dt)


def _step_guided(
    gains: whole_body.WholeBodyGains,
    carry: guided.GuidedArmCarry,
    inputs: StageInput,
    command: PoseTarget | TrackingTarget | BodyTwist | EndEffectorTarget,
) -> tuple[guided.GuidedArmCarry, Command]:
    links = inputs.params.vehicle_model.links
    return guided.step(gains, links, carry, inputs.estimate, command, inputs.joints, inputs.dt)


def _step_leader_follower(
    gains: leader_follower.LeaderFollowerGains,
    carry: leader_follower.LeaderFollowerCarry,
    inputs: StageInput,
    command: BodyTwist,
) -> tuple[leader_follower.LeaderFollowerCarry, BodyTwist]:
    params = inputs.params
    return leader_follower.step(
        gains, params.vehicle_model, params.is_leader, carry, inputs.estimate, command, inputs.dt
    )


def _step_link_wrench(
    gains: link_wrench.LinkWrenchGains, carry: tuple[()], inputs: StageInput, command: BodyWrench
) -> tuple[tuple[()], BodyWrench]:
    return carry, link_wrench.step(
        gains,
        inputs.params.vehicle_model,
        inputs.estimate,
        inputs.joints,
        command,
        inputs.dt,
        inputs.density,
        inputs.gravity,
    )


_ALL = (
    Stage(
        name="follow",
        takes=_PATHS,
        gives=PoseTarget,
        step=_step_follow,
        reset=lambda _, yaw_rad: follow.reset(yaw_rad),
        gains=follow.FollowGains,
        check=follow.check,
        progress=_plan_clock,
    ),
    Stage(
        name="reference",
        takes=_PATHS,
        gives=TrackingTarget,
        step=_step_track,
        reset=lambda _, yaw_rad: follow.reset(yaw_rad),
        gains=follow.FollowGains,
        check=lambda gains: follow.check(gains, "reference"),
        progress=_plan_clock,
    ),
    _of_law(
        "admittance",
        admittance,
        admittance.AdmittanceGains,
        _POSES,
        PoseTarget,
        flow=True,
        grip=True,
    ),
    _of_law("los", los, los.LosGains, (Trajectory,), BodyTwist, fins=True, progress=los.progress_s),
    _of_law(
        "glide",
        glide,
        glide.GlideGains,
        (Trajectory,),
        ThrusterPwm,
        glides=True,
        progress=glide.progress_s,
    ),
    Stage(
        name="pose",
        takes=_POSES,
        gives=BodyTwist,
        step=_step_pose,
        reset=_no_memory,
        gains=pose.PoseGains,
        check=pose.check,
    ),
    Stage(
        name="guided",
        takes=(*_POSES, EndEffectorTarget, BodyTwist),
        gives=TrackingTarget,
        step=_step_guided,
        reset=guided.reset,
        gains=whole_body.WholeBodyGains,
        check=whole_body.check,
    ),
    _of_law("pid_pose", pid_pose, pid_pose.PidPoseGains, _POSES, BodyTwist),
    Stage(
        name="whole_body",
        takes=(EndEffectorTarget, BodyTwist),
        gives=BodyTwist,
        step=_step_whole_body,
        reset=lambda estimate, _: whole_body.reset(estimate),
        gains=whole_body.WholeBodyGains,
        check=whole_body.check,
    ),
    Stage(
        name="leader_follower",
        takes=(BodyTwist,),
        gives=BodyTwist,
        step=_step_leader_follower,
        reset=lambda estimate, _: leader_follower.reset(estimate),
        gains=leader_follower.LeaderFollowerGains,
        check=leader_follower.check,
        wants_flow=True,
        wants_grip=True,
    ),
    _of_law("velocity", velocity, velocity.VelocityGains, (BodyTwist,), BodyWrench),
    _of_law(
        "pid_velocity",
        pid_velocity,
        pid_velocity.PidVelocityGains,
        (BodyTwist,),
        BodyWrench,
        realised=True,
    ),
    _of_law("ismc", ismc, ismc.IsmcGains, (BodyTwist,), BodyWrench),
    _of_law("aitsm", aitsm, aitsm.AitsmGains, (BodyTwist,), BodyWrench),
    _of_law(
        "tracking",
        tracking,
        tracking.TrackingGains,
        _POSES,
        BodyWrench,
        flow=True,
        realised=True,
    ),
    _of_law(
        "computed_torque",
        computed_torque,
        computed_torque.ComputedTorqueGains,
        _POSES,
        BodyWrench,
        flow=True,
    ),
    Stage(
        name="link_wrench",
        takes=(BodyWrench,),
        gives=BodyWrench,
        step=_step_link_wrench,
        reset=_no_memory,
        gains=link_wrench.LinkWrenchGains,
        check=link_wrench.check,
    ),
    _of_law(
        "cargo_wrench",
        cargo_wrench,
        cargo_wrench.CargoWrenchGains,
        (BodyWrench,),
        BodyWrench,
        flow=True,
    ),
    _of_law(
        "grip_moment",
        grip_moment,
        grip_moment.GripMomentGains,
        (BodyWrench,),
        BodyWrench,
        grip=True,
    ),
    _allocation_stage("pseudo_inverse", allocation.allocate),
    _allocation_stage("prioritized", allocation.allocate_to_limits),
    _of_law("ardusub", ardusub, ardusub.ArduSubGains, _POSES, ThrusterPwm, sway=True),
)

STAGES = {stage.name: stage for stage in _ALL}
"""Every stage by its name."""

CONTROLLERS: dict[str, tuple[str, ...]] = {
    "cascade": ("follow", "pose", "velocity", "pseudo_inverse"),
    "pid": ("follow", "pid_pose", "pid_velocity", "pseudo_inverse"),
    "los": ("los", "velocity", "pseudo_inverse"),
    "tracking": ("reference", "tracking", "pseudo_inverse"),
    "computed_torque": ("reference", "computed_torque", "pseudo_inverse"),
    "ismc": ("follow", "pose", "ismc", "pseudo_inverse"),
    "aitsm": ("follow", "pose", "aitsm", "pseudo_inverse"),
    "arm": ("follow", "pose", "whole_body", "velocity", "link_wrench", "pseudo_inverse"),
    "ardusub": ("follow", "ardusub"),
}
"""The stages of each stack that has a name and flies by thrust; all take a planner's `Trajectory`.
The laws that feed a current forward (tracking, computed_torque) are told it; those that reject what
they do not know (ismc, aitsm, and all with an integral alone) are not."""


GLIDER_CONTROLLERS: dict[str, tuple[str, ...]] = {"glide": ("glide",)}
"""The stages of each stack that has a name and flies vehicles without thrust."""


def named_stacks() -> dict[str, tuple[str, ...]]:
    """Return the stages of each stack that has a name."""
    return {**CONTROLLERS, **GLIDER_CONTROLLERS}


def find_stage(name: str) -> Stage:
    """Return a stage by its name, or that of a user's control law, FILE.py:CLASS.

    Raises:
        ConfigError: there is no such stage; the file or its class is no control law.
    """
    if is_class_of_file(name):
        return _user_stage(load_class(name, "control law"))
    if name not in STAGES:
        raise ConfigError(
            f"stages: unknown {name!r}; there is {', '.join(STAGES)}, or give a class of a file as "
            "FILE.py:CLASS"
        )
    return STAGES[name]


@cache
def _user_stage(law_class: type) -> Stage:
    """Return the stage of a user's class; CONTRIBUTING.md says what it has to have."""
    name = law_class.__name__
    missing = [entry for entry in ("takes", "gives", "step") if not hasattr(law_class, entry)]
    if missing:
        raise ConfigError(f"control law {name}: has no {' and no '.join(missing)}")
    law: Any = law_class()
    takes = tuple(law.takes)
    commands = {*_PATHS, *_POSES, BodyTwist, BodyWrench, EndEffectorTarget}
    if unknown := [kind for kind in takes if kind not in commands]:
        raise ConfigError(f"control law {name}: takes {unknown[0]!r}, which is no command")
    if law.gives not in {*_POSES, BodyTwist, BodyWrench, ThrusterPwm}:
        raise ConfigError(f"control law {name}: gives {law.gives!r}, which is no command")
    if name in STAGES:
        raise ConfigError(f"control law {name}: a built-in stage has this name; take another one")
    return Stage(
        name=name,
        takes=takes,
        gives=law.gives,
        step=law.step,
        reset=(lambda estimate, _: law.reset(estimate)) if hasattr(law, "reset") else _no_memory,
        gains=_register_gains(name, getattr(law_class, "Gains", stack.NoGains)),
        check=getattr(law, "check", None),
        wants_flow=getattr(law, "wants_flow", False),
        wants_realised=getattr(law, "wants_realised", False),
        wants_grip=getattr(law, "wants_grip", False),
        wants_sway=getattr(law, "wants_sway", False),
        flies_by_fins=getattr(law, "flies_by_fins", False),
        glides=getattr(law, "glides", False),
        progress=getattr(law, "progress", None),
    )


def _register_gains(name: str, gains: type) -> type:
    """Return the dataclass of a law's gains, as a pytree."""
    if not is_dataclass(gains):
        raise ConfigError(f"control law {name}: Gains is no dataclass")
    try:
        made = gains()
    except TypeError as error:
        raise ConfigError(f"control law {name}: each of its Gains has to have a default") from error
    if jax.tree.leaves(made) == [made]:
        jax.tree_util.register_dataclass(gains)
    return gains


def find_controller(controller: str) -> Stages:
    """The stages of a stack that has a name."""
    return tuple(STAGES[name] for name in named_stacks()[controller])


def describe_stages(stages: Stages) -> str:
    """A stack in words: its name, or its stages."""
    names = tuple(stage.name for stage in stages)
    for name, members in named_stacks().items():
        if members == names:
            return f"controller {name!r}"
    return f"the controller of stages {_quote_names(names)}"


def build_stack(
    names: Sequence[str],
    gains: Mapping[str, Mapping[str, float]],
) -> tuple[Stages, StackGains]:
    """A stack by the names of its stages, and the gains of each (host side).

    Args:
        names: from the highest to the lowest; FILE.py:CLASS for a user's control law.
        gains: by stage and gain, those that differ from a stage's own; a user's stage has the name
            of its class.

    Raises:
        ConfigError: a stage or gain that is not known, a gain that makes no sense, stages that do
            not fit; one message with every fault.
    """
    stages = tuple(find_stage(name) for name in names)
    names = tuple(stage.name for stage in stages)
    faults = fit_faults(stages)
    faults += [
        f"gains.{name}: the stack has no such stage; its stages are {', '.join(names)}"
        for name in gains
        if name not in names
    ]
    made = []
    for stage in stages:
        numbers = gains.get(stage.name, {})
        gain_names = [entry.name for entry in fields(stage.gains())]
        faults += [
            f"gains.{stage.name}.{name} = {value:g}: unknown gain; there is "
            + (", ".join(gain_names) or "none")
            for name, value in numbers.items()
            if name not in gain_names
        ]
        made.append(stage.gains(**{name: x for name, x in numbers.items() if name in gain_names}))
        try:
            if stage.check is not None:
                stage.check(made[-1])
        except ConfigError as error:
            faults.append(str(error))
    if faults:
        raise ConfigError("; ".join(faults))
    return stages, tuple(made)


def fit_faults(stages: Stages) -> list[str]:
    """What keeps stages from being a stack: pairs that do not fit, a wrong end, one twice."""
    if not stages:
        return ["stages: empty; name at least one"]
    faults = [
        f"stages: {upper.name!r} gives {upper.gives.__name__}, but {lower.name!r} below it takes "
        f"{stack.describe_inputs(lower)}"
        for upper, lower in itertools.pairwise(stages)
        if upper.gives not in lower.takes
    ]
    if stages[-1].gives is not ThrusterPwm:
        faults.append(
            f"stages: the last one, {stages[-1].name!r}, gives {stages[-1].gives.__name__}; a "
            "stack ends in ThrusterPwm: put an allocation below it"
        )
    names = [stage.name for stage in stages]
    twice = sorted({name for name in names if names.count(name) > 1})
    if twice:
        faults.append(f"stages: {_quote_names(twice)} more than once; its gains would be one")
    return faults


def _quote_names(names: Sequence[str]) -> str:
    return ", ".join(map(repr, names))
