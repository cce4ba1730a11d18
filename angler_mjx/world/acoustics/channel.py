"""The shared channel of the robots of a world: packets in flight, and information received.

A packet holds its sender's data at its beginning. It arrives at each receiver after the travel time
of sound and is received when its last bit is in, if the link lets it through, no other packet
arrives at the same time, and the receiver does not send. Times are continuous; robots begin
packets, and get received ones, in control steps.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import TYPE_CHECKING, Any

import jax
import jax.numpy as jnp

from angler_mjx._moved import renamed_attribute
from angler_mjx.periods import every_n_steps
from angler_mjx.sampling import fold_keys
from angler_mjx.world.acoustics.access import Access, Aloha, Tdma
from angler_mjx.world.acoustics.link import Link, LinkBudget
from angler_mjx.world.acoustics.shadow import RockLoss
from angler_mjx.world.rock.grid import Grid

NEVER_S = -1e6
"""Start time of packets that were never sent."""
OF_CHANCE = 0x53454E44
"""Constant folded into the key of a world and step to sample the senders; the plain key samples
losses."""


@dataclass(frozen=True, kw_only=True)
class Channel:
    """A shared channel; hashable, static under jit."""

    access: Access
    link: Link
    rock: RockLoss | None
    """Loss in rock; None: rock has no effect on sound."""
    sound_mps: float
    packet_s: float
    """Duration of a packet."""
    dt_s: float
    """Control period."""
    lost_after_s: float = 60.0
    """Silence after which a robot is considered lost."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class Packet:
    """The last packet of each robot; [R] leads."""

    p_m: jax.Array
    """[R, 3] the sender's estimate of its position when the packet began, in W."""
    v_mps: jax.Array
    """[R, 3] the sender's estimate of its velocity over ground, in W."""
    time_s: jax.Array
    """[R] time of the estimates."""
    payload: Any = None
    """Additional data of any shape, [R] leading."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class HeardRobots:
    """Information of robots on each other; [receiver, sender] leads.

    No robot receives packets from itself. A sender not yet heard has its start position, at rest,
    and the payload of the start.
    """

    p_m: jax.Array
    """[R, R, 3] the sender's estimate of its position, in W."""
    v_mps: jax.Array
    """[R, R, 3] the sender's estimate of its velocity over ground, in W."""
    time_s: jax.Array
    """[R, R] time of the estimates since the start."""
    is_heard: jax.Array
    """bool [R, R] whether a packet of the sender was received."""
    payload: Any = None
    """Additional data of the sender, [R, R] leading."""

    if not TYPE_CHECKING:  # hidden from type checkers, which would accept any attribute

        def __getattr__(self, name: str) -> Any:
            """Return a field by its name before 0.2, with a DeprecationWarning."""
            return renamed_attribute(self, name, {"place_m": "extrapolate_m", "words": "payload"})

    def extrapolate_m(self, time_s: jax.Array) -> jax.Array:
        """Return [R, R, 3] the senders' positions at a time [], extrapolated by velocity."""
        return self.p_m + self.v_mps * (time_s - self.time_s)[..., None]


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class InFlight:
    """Packets in flight; [receiver, sender] leads where there are two."""

    packet: Packet
    arrive_s: jax.Array
    """[R, R] arrival time of the first bit of the last packet; its beginning on the diagonal."""
    passes: jax.Array
    """bool [R, R] whether it is in flight and will be received, by the collisions and losses so
    far."""
    loud: jax.Array | None
    """bool [R, R] whether it interferes with others; None in access by turns."""
    sent: jax.Array
    """int32 [R] packets sent by each robot."""


@jax.tree_util.register_dataclass
@dataclass(frozen=True, kw_only=True)
class ModemState:
    """State of the channel of one world."""

    in_flight: InFlight
    heard: HeardRobots
    n_received: jax.Array
    """int32 [R] packets received by each robot."""


def begin_channel(channel: Channel, p_m: jax.Array, payload: object = None) -> ModemState:
    """Return the state of the channel before any packet.

    Args:
        channel: shared channel.
        p_m: [R, 3] start positions of the robots, in W.
        payload: additional data of each robot, [R] leading.
    """
    n, zero = p_m.shape[0], jnp.zeros_like(p_m)
    nobody, none = jnp.zeros((n, n), bool), jnp.zeros(n, jnp.int32)
    in_flight = InFlight(
        packet=Packet(p_m=p_m, v_mps=zero, time_s=zero[:, 0], payload=payload),
        arrive_s=jnp.full((n, n), NEVER_S, p_m.dtype),
        passes=nobody,
        loud=None if isinstance(channel.access, Tdma) else nobody,
        sent=none,
    )
    return ModemState(in_flight=in_flight, heard=init_heard(p_m, payload), n_received=none)


def init_heard(p_m: jax.Array, payload: object = None) -> HeardRobots:
    """Return the initial information of robots that start at p_m [R, 3]."""
    n = p_m.shape[0]

    def to_all(leaf: jax.Array) -> jax.Array:
        return jnp.broadcast_to(leaf, (n, *leaf.shape))

    return HeardRobots(
        p_m=to_all(p_m),
        v_mps=to_all(jnp.zeros_like(p_m)),
        time_s=jnp.zeros((n, n), p_m.dtype),
        is_heard=jnp.zeros((n, n), bool),
        payload=jax.tree.map(to_all, payload),
    )


@dataclass(frozen=True, kw_only=True)
class ChannelInput:
    """Inputs of a control step of one world."""

    key: jax.Array
    """Key of this world and step."""
    number: jax.Array
    """int32 [] control steps taken; a single number for all worlds of a batch, so that periodic
    computations cost nothing in the other steps."""
    p_m: jax.Array
    """[R, 3] positions of the robots, in W."""
    grid: Grid
    """Rock cells."""
    make_packet: Callable[[], Packet]
    """Returns the current packets of the robots; called where packets begin."""
    silent: jax.Array | None = None
    """bool [R] robots that cannot send."""
    every: int = 1
    """Known divisor of the number."""

    def every_n_steps[T](self, period: int, do: Callable[[], T], otherwise: Callable[[], T]) -> T:
        """See `periods.every_n_steps`."""
        return every_n_steps(period, self.number, do, otherwise, self.every)

    def time_s(self, channel: Channel) -> jax.Array:
        """Return the time [] at the beginning of the step."""
        return self.number.astype(self.p_m.dtype) * channel.dt_s


def step(channel: Channel, memory: ModemState, now: ChannelInput) -> tuple[ModemState, jax.Array]:
    """Take a control step of one world: receive packets, and begin others.

    Args:
        channel: shared channel.
        memory: state of the channel.
        now: the step.

    Returns:
        The state, and packets received by now, bool [receiver, sender].
    """
    if isinstance(channel.access, Tdma):
        return _step_tdma(channel, channel.access, memory, now)
    return _step_aloha(channel, channel.access, memory, now)


def _step_tdma(
    channel: Channel, access: Tdma, memory: ModemState, now: ChannelInput
) -> tuple[ModemState, jax.Array]:
    """Take a step with one packet in flight at a time: only its sender is processed."""
    robots = now.p_m.shape[0]
    last = _SenderColumns(first=jnp.maximum(now.number - 1, 0) // access.slot % robots, count=1)
    turn = _SenderColumns(first=now.number // access.slot % robots, count=1)
    # By the next slot all packets have arrived, with any rounding of times.
    memory, came = _deliver_packets(channel, memory, now, last, now.number % access.slot == 0)
    always = jnp.ones(1, bool)

    def send(in_flight: InFlight) -> InFlight:
        return _begin_packets(
            channel, in_flight, now, turn, always, jnp.full(1, now.time_s(channel))
        )

    in_flight = now.every_n_steps(
        access.slot, lambda: send(memory.in_flight), lambda: memory.in_flight
    )
    everybody = last.put(jnp.zeros((robots, robots), bool), came, 1)
    return replace(memory, in_flight=in_flight), everybody


def _step_aloha(
    channel: Channel, access: Aloha, memory: ModemState, now: ChannelInput
) -> tuple[ModemState, jax.Array]:
    """Take a step in which any robot may send."""
    robots, dtype = now.p_m.shape[0], now.p_m.dtype
    everybody = _SenderColumns(first=None, count=robots)
    chance_s = access.chance * channel.dt_s

    def send(in_flight: InFlight) -> InFlight:
        sender_key, time_key = fold_keys(jax.random.fold_in(now.key, OF_CHANCE), 2)
        begun_s, at_s = jnp.diagonal(in_flight.arrive_s), jnp.full(robots, now.time_s(channel))
        rested = begun_s < at_s - (access.rests - 1) * chance_s
        if not access.slotted:
            at_s = at_s + chance_s * jax.random.uniform(time_key, (robots,), dtype)
        chosen = jax.random.uniform(sender_key, (robots,), dtype) < access.probability
        return _begin_packets(channel, in_flight, now, everybody, chosen & rested, at_s)

    def look(memory: ModemState) -> tuple[ModemState, jax.Array]:
        memory, came = _deliver_packets(channel, memory, now, everybody)
        in_flight = now.every_n_steps(
            access.chance, lambda: send(memory.in_flight), lambda: memory.in_flight
        )
        return replace(memory, in_flight=in_flight), came

    def wait() -> tuple[ModemState, jax.Array]:
        return memory, jnp.zeros((robots, robots), bool)

    return now.every_n_steps(access.look, lambda: look(memory), wait)


@dataclass(frozen=True, kw_only=True)
class _SenderColumns:
    """A range of adjacent senders: a single sender, or all."""

    first: jax.Array | None
    """int32 []; None for all."""
    count: int

    @property
    def rows(self) -> jax.Array:
        """Return the indices int32 [count]."""
        return jnp.arange(self.count) + (0 if self.first is None else self.first)

    def of[T](self, tree: T, axis: int) -> T:
        """Return the senders' part of arrays with senders along an axis."""
        first = self.first
        if first is None:
            return tree
        cut = partial(jax.lax.dynamic_slice_in_dim, slice_size=1, axis=axis)
        part: T = jax.tree.map(lambda leaf: cut(leaf, first), tree)
        return part

    def put[T](self, tree: T, part: T, axis: int) -> T:
        """Return the arrays with this part replaced."""
        first = self.first
        if first is None:
            return part
        put = partial(jax.lax.dynamic_update_slice_in_dim, axis=axis)
        replaced: T = jax.tree.map(lambda leaf, new: put(leaf, new, first), tree, part)
        return replaced


def _deliver_packets(
    channel: Channel,
    memory: ModemState,
    now: ChannelInput,
    senders: _SenderColumns,
    over: jax.Array | bool = False,
) -> tuple[ModemState, jax.Array]:
    """Receive the packets whose last bit has arrived by now, bool [receiver, count].

    Args:
        channel: shared channel.
        memory: state before the step.
        now: the step.
        senders: robots whose packets may be in flight.
        over: bool [] whether their time is over, so that all have arrived.
    """
    in_flight, robots = memory.in_flight, memory.n_received.shape[0]
    arrive, passes = senders.of((in_flight.arrive_s, in_flight.passes), 1)
    came = passes & ((arrive + channel.packet_s <= now.time_s(channel)) | over)
    packet: Packet = senders.of(in_flight.packet, 0)
    old = senders.of(memory.heard, 1)
    new = HeardRobots(
        p_m=packet.p_m,
        v_mps=packet.v_mps,
        time_s=packet.time_s,
        is_heard=came,
        payload=packet.payload,
    )

    def put(new: jax.Array, old: jax.Array) -> jax.Array:
        took = came.reshape(robots, senders.count, *(1,) * (old.ndim - 2))
        return jnp.where(took, new, old)

    heard = replace(jax.tree.map(put, new, old), is_heard=old.is_heard | came)
    after = ModemState(
        in_flight=replace(in_flight, passes=senders.put(in_flight.passes, passes & ~came, 1)),
        heard=senders.put(memory.heard, heard, 1),
        n_received=memory.n_received + jnp.sum(came, axis=1, dtype=jnp.int32),
    )
    return after, came


def _begin_packets(
    channel: Channel,
    in_flight: InFlight,
    now: ChannelInput,
    senders: _SenderColumns,
    begins: jax.Array,
    at_s: jax.Array,
) -> InFlight:
    """Begin packets in this step.

    Args:
        channel: shared channel.
        in_flight: packets before the step.
        now: the step.
        senders: robots that may begin a packet.
        begins: bool [count] robots that begin a packet.
        at_s: [count] times of beginning.
    """
    if now.silent is not None:
        begins = begins & ~senders.of(now.silent, 0)
    from_m = senders.of(now.p_m, 0)
    is_self = jnp.arange(now.p_m.shape[0])[:, None] == senders.rows
    distance = jnp.sqrt(jnp.sum((now.p_m[:, None] - from_m) ** 2, axis=-1))
    rock_db = jnp.zeros_like(distance)
    if channel.rock is not None:
        loss = partial(channel.rock.loss_db, now.grid)
        rock_db = jax.vmap(jax.vmap(loss, (0, None)), (None, 0))(from_m, now.p_m)
    chance = channel.link.success(distance, rock_db)
    if isinstance(channel.link, LinkBudget):
        luck = jax.random.uniform(now.key, chance.shape, chance.dtype)
    else:
        luck = jnp.full_like(chance, 0.5)

    def put[T](new: T, old: T, axis: int) -> T:
        """Return the new values for robots that begin a packet."""

        def choose(new: jax.Array, old: jax.Array) -> jax.Array:
            is_sender = begins.reshape(-1, *(1,) * (old.ndim - 1 - axis))
            return jnp.where(is_sender, new, old)

        chosen: T = jax.tree.map(choose, new, senders.of(old, axis))
        return senders.put(old, chosen, axis)

    arrive = put(at_s + distance / channel.sound_mps, in_flight.arrive_s, 1)
    passes = put((luck < chance) & ~is_self, in_flight.passes, 1)
    loud = in_flight.loud
    if loud is not None:
        loud = put(channel.link.loud(distance, rock_db) | is_self, loud, 1)
        passes &= ~_is_drowned(arrive, loud, channel.packet_s)
    return InFlight(
        packet=put(senders.of(now.make_packet(), 0), in_flight.packet, 0),
        arrive_s=arrive,
        passes=passes,
        loud=loud,
        sent=put(senders.of(in_flight.sent, 0) + 1, in_flight.sent, 0),
    )


def _is_drowned(arrive_s: jax.Array, loud: jax.Array, packet_s: float) -> jax.Array:
    """Return whether another packet overlaps each at its receiver, or it sends; bool [R, R].

    A packet replaces another only after that has passed all receivers, so packets are compared with
    all possible overlaps when the later of two begins.
    """
    apart = jnp.abs(arrive_s[:, :, None] - arrive_s[:, None, :])
    other = ~jnp.eye(arrive_s.shape[0], dtype=bool)
    return jnp.any((apart < packet_s) & loud[:, None, :] & other, axis=-1)
