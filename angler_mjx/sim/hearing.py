"""What robots tell each other by acoustics, and what comes of it for tasks and policies.

A part of a control step, after the instruments: packets come in, and others begin. What a packet
holds beside place and velocity is said by the task and the policy, and told to them again.
"""

from collections.abc import Callable
from dataclasses import replace

import jax
import jax.numpy as jnp

from angler_kernels import quaternion
from angler_mjx.errors import ConfigError
from angler_mjx.sim.physics.step import VehicleState
from angler_mjx.sim.policy import Policy, PolicyMemory
from angler_mjx.sim.record import AcousticsRecord, Belief
from angler_mjx.sim.state import World
from angler_mjx.world.acoustics import channel
from angler_mjx.world.acoustics.channel import (
    Channel,
    ChannelInput,
    HeardRobots,
    ModemState,
    Packet,
)
from angler_mjx.world.tasks import task_belief
from angler_mjx.world.tasks.spec import TaskReport, TaskState


def reset(
    shared: Channel,
    start_m: jax.Array,
    policy: Policy | None,
    memory: PolicyMemory | None,
    task: TaskState | None,
) -> ModemState:
    """The channel of a world before anything is said.

    Args:
        shared: channel.
        start_m: [R, 3] where robots start, in W.
        policy: that commands them, if one does.
        memory: of the policy.
        task: what is known of it, if there is one.
    """
    return channel.begin_channel(
        shared, start_m, build_payload(policy, memory, task, {"policy": None})
    )


def step(
    shared: Channel,
    world: World,
    memory: ModemState,
    number: jax.Array,
    t: jax.Array,
    p_m: jax.Array,
    estimate: VehicleState | Belief,
    make_payload: Callable[[], dict[str, object]],
    every: int = 1,
) -> tuple[ModemState, jax.Array]:
    """One control step of one world.

    Args:
        shared: channel.
        world: constants of the world.
        memory: of the channel.
        number: int32 [] control steps taken.
        t: [] s.
        p_m: [R, 3] where robots are, in W.
        estimate: their motion as they are told it: a belief, or their true state.
        make_payload: what they put into a packet beside that, worked out where one begins.
        every: what ``number`` is known to be a multiple of.

    Returns:
        The memory, and who understood a packet of whom by now, bool [receiver, sender].

    Raises:
        ConfigError: the world has no key for its channel.
    """
    if world.acoustics_key is None:
        raise ConfigError(
            "acoustics: the worlds were drawn without keys for it; draw them by a scenario with "
            "the same table"
        )

    def build_packet() -> Packet:
        return Packet(
            p_m=estimate.p,
            v_mps=jax.vmap(quaternion.rotate)(estimate.q, estimate.nu[:, :3]),
            time_s=jnp.full(p_m.shape[0], t),
            payload=make_payload(),
        )

    key = jax.random.fold_in(jax.random.wrap_key_data(world.acoustics_key), number)
    now = ChannelInput(
        key=key,
        number=number,
        p_m=p_m,
        grid=world.environment.grid,
        make_packet=build_packet,
        every=every,
        silent=None if world.fails_at_s is None else t >= world.fails_at_s,
    )
    return channel.step(shared, memory, now)


def build_payload(
    policy: Policy | None,
    memory: PolicyMemory | None,
    task: TaskState | None,
    before: dict[str, object],
    running: jax.Array | None = None,
) -> dict[str, object]:
    """What robots say in a packet beside where they are, [R] leading, by who says it.

    Args:
        policy: that commands them, if one does.
        memory: of the policy.
        task: what they know of it, if there is one.
        before: what they said last; the policy's again where a command stands in for it.
        running: bool [R] whose episode goes on; all if left out.
    """
    policy_payload = before["policy"]
    if policy is not None and memory is not None:
        policy_payload = policy.payload(memory.carry)
    return {
        "policy": policy_payload,
        "task": None if task is None else task_belief.build_report(task, running),
    }


def policy_reports(modem: ModemState | None) -> HeardRobots | None:
    """What a policy is told of what was heard: no words but its own."""
    return None if modem is None else replace(modem.heard, payload=modem.heard.payload["policy"])


def working_robots(
    shared: Channel | None, modem: ModemState | None, t: jax.Array
) -> task_belief.HeardReports | None:
    """Where each robot takes the others to be at t [] s, and who of them still is at work."""
    if shared is None or modem is None:
        return None
    heard = modem.heard
    reports: TaskReport = heard.payload["task"]
    recent = t - heard.time_s < shared.lost_after_s
    return task_belief.HeardReports(
        p=heard.extrapolate_m(t),
        active=recent & reports.at_work,
        report=reports,
        lost_after_s=shared.lost_after_s,
    )


def record_acoustics(modem: ModemState, t: jax.Array) -> AcousticsRecord:
    """What is recorded of `hear` at t [] s."""
    robots = modem.n_received.shape[0]
    sent = jnp.sum(modem.in_flight.sent) - modem.in_flight.sent
    age = jnp.where(jnp.eye(robots, dtype=bool), 0.0, t - modem.heard.time_s)
    return AcousticsRecord(
        fraction=modem.n_received / sent, age_s=jnp.sum(age, axis=1) / (robots - 1)
    )
