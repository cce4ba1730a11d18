"""Packets in worlds without vehicles: robots stand, or go straight on."""

from dataclasses import replace
from functools import cache, partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.world.acoustics import access, channel
from angler_mjx.world.acoustics.channel import Channel, ChannelInput, Packet
from angler_mjx.world.acoustics.link import LinkBudget, RangeLink
from angler_mjx.world.acoustics.shadow import RockLoss
from angler_mjx.world.rock.grid import Grid

from ...compiling import quickly

DT_S, PACKET_S = 0.05, 1.0
NOWHERE = Grid(
    occupied=jnp.zeros((1, 1, 1), bool), origin_m=jnp.array([1e4, 1e4, 1e4]), cell_m=jnp.array(1.0)
)


def shared(turns, **more):
    plain = Channel(
        access=turns,
        link=RangeLink(range_m=1e6),
        rock=None,
        sound_mps=1500.0,
        packet_s=PACKET_S,
        dt_s=DT_S,
    )
    return replace(plain, **more)


@cache
def flight(one, robots, steps, words=False):
    """Compiled steps of worlds: [W] keys, places [W, R, 3], velocities [W, R, 3], rock."""

    def world(key, start_m, v_mps, grid):
        said = jnp.zeros(robots) if words else None

        def step(memory, number):
            t = number * DT_S
            p = start_m + v_mps * t
            now = ChannelInput(
                key=jax.random.fold_in(key, number),
                number=number,
                p_m=p,
                grid=grid,
                make_packet=lambda: Packet(
                    p_m=p,
                    v_mps=v_mps,
                    time_s=jnp.full(robots, t),
                    payload=jnp.arange(robots) + 100.0 * number if words else None,
                ),
            )
            memory, came = channel.step(one, memory, now)
            return memory, (came, memory.heard)

        begin = channel.begin_channel(one, start_m, said)
        return jax.lax.scan(step, begin, jnp.arange(steps))

    return quickly(jax.vmap(world, (0, 0, 0, None)))


def fly(one, start_m, steps, *, worlds=1, v_mps=0.0, grid=NOWHERE, words=False, seed=0):
    start = np.broadcast_to(np.asarray(start_m, np.float32), (worlds, *np.shape(start_m)))
    v = np.broadcast_to(np.asarray(v_mps, np.float32), start.shape)
    keys = jax.random.split(jax.random.key(seed), worlds)
    run = flight(one, start.shape[1], steps, words)
    return jax.device_get(run(keys, jnp.asarray(start), jnp.asarray(v), grid))


ROW_M = np.array([[0.0, 0.0, -5.0], [15.0, 0.0, -5.0], [0.0, 60.0, -5.0]])


@pytest.fixture(scope="module")
def turns():
    """Three robots at rest, four frames of a perfect channel."""
    one = shared(access.build_tdma(PACKET_S, 0.1, DT_S))
    steps = 4 * 3 * one.access.slot
    return one, steps, fly(one, ROW_M, steps, words=True)


def test_slots_hold_a_packet_and_the_longest_way():
    assert access.build_tdma(1.0, 0.1, 0.05).slot == 23
    assert access.build_tdma(1.0, 0.12, 0.05).slot == 23
    assert access.build_tdma(0.01, 0.001, 0.05).slot == 1


def test_taking_turns_nothing_is_lost(turns):
    one, _, (end, (came, _)) = turns
    np.testing.assert_array_equal(end.in_flight.sent, [[4, 4, 4]])
    # The last robot's last packet is in only when the next slot begins.
    expected = 4 * (1 - np.eye(3, dtype=int))
    expected[:2, 2] -= [1, 1] if one.access.slot * DT_S <= PACKET_S + 62 / 1500 else [0, 0]
    np.testing.assert_array_equal(came[0].sum(axis=0), expected)
    np.testing.assert_array_equal(end.n_received[0], expected.sum(axis=1))


def test_packets_come_after_the_way_of_sound(turns):
    one, steps, (_, (came, _)) = turns
    for receiver in range(3):
        for sender in {0, 1, 2} - {receiver}:
            way_s = np.linalg.norm(ROW_M[receiver] - ROW_M[sender]) / 1500.0
            begun = (np.arange(4) * 3 + sender) * one.access.slot * DT_S
            told = np.ceil((begun + way_s + PACKET_S) / DT_S - 1e-4).astype(int)
            found = np.flatnonzero(came[0, :, receiver, sender])
            np.testing.assert_array_equal(found, told[told < steps])


def test_mean_age_is_that_of_a_saw(turns):
    """From the age at which a packet is told, one frame of growing until the next."""
    one, steps, (_, (_, heard)) = turns
    frame_s = 3 * one.access.slot * DT_S
    age = np.arange(steps)[:, None, None] * DT_S - heard.time_s[0]
    for receiver in range(3):
        for sender in {0, 1, 2} - {receiver}:
            way_s = np.linalg.norm(ROW_M[receiver] - ROW_M[sender]) / 1500.0
            youngest_s = np.ceil((way_s + PACKET_S) / DT_S) * DT_S
            warm = age[2 * 3 * one.access.slot : 3 * 3 * one.access.slot, receiver, sender]
            assert warm.min() == pytest.approx(youngest_s, abs=1e-4)
            assert warm.mean() == pytest.approx(youngest_s + (frame_s - DT_S) / 2, abs=1e-4)


def test_what_is_told_is_of_the_time_of_sending(turns):
    one, _, (_, (came, heard)) = turns
    step, receiver, sender = (int(x[0]) for x in np.nonzero(came[0]))
    sent_at = sender * one.access.slot
    assert step > sent_at
    assert heard.payload[0, step, receiver, sender] == sender + 100.0 * sent_at
    assert heard.time_s[0, step, receiver, sender] == pytest.approx(sent_at * DT_S)


def test_a_robot_that_flies_is_heard_where_it_was():
    one = shared(access.build_tdma(PACKET_S, 0.1, DT_S))
    v = np.array([[0.5, 0.0, 0.0], [0.0, -0.3, 0.1], [0.0, 0.0, 0.0]])
    end, (_, heard) = fly(one, ROW_M, 4 * 3 * one.access.slot, v_mps=v)
    for receiver in range(3):
        for sender in {0, 1, 2} - {receiver}:
            t = heard.time_s[0, -1, receiver, sender]
            np.testing.assert_allclose(
                heard.p_m[0, -1, receiver, sender], ROW_M[sender] + v[sender] * t, atol=1e-4
            )
            np.testing.assert_allclose(heard.v_mps[0, -1, receiver, sender], v[sender])
    # Straight on from there it is where it is.
    now_s = (4 * 3 * one.access.slot - 1) * DT_S
    there = jax.tree.map(lambda x: x[0], end.heard).extrapolate_m(jnp.array(now_s))
    other = ~np.eye(3, dtype=bool)
    np.testing.assert_allclose(
        np.asarray(there)[other], np.broadcast_to(ROW_M + v * now_s, (3, 3, 3))[other], atol=1e-4
    )


def test_nobody_hears_itself_and_who_is_far_hears_nothing(turns):
    _, _, (_, (came, heard)) = turns
    assert not came[0][:, np.eye(3, dtype=bool)].any()
    assert not heard.is_heard[0][:, np.eye(3, dtype=bool)].any()
    near = shared(access.build_tdma(PACKET_S, 0.1, DT_S), link=RangeLink(range_m=20.0))
    end, _ = fly(near, ROW_M, 4 * 3 * near.access.slot)
    np.testing.assert_array_equal(end.n_received, [[4, 4, 0]])


def test_rock_throws_shadows():
    occupied = np.zeros((4, 4, 4), bool)
    occupied[1] = True  # between robot 0 and robot 1, not between 0 and 2
    grid = Grid(
        occupied=jnp.asarray(occupied),
        origin_m=jnp.array([2.0, -5.0, -10.0]),
        cell_m=jnp.array(2.5),
    )
    one = shared(access.build_tdma(PACKET_S, 0.1, DT_S), rock=RockLoss(db_per_m=None))
    end, _ = fly(one, ROW_M, 4 * 3 * one.access.slot, grid=grid)
    known = end.heard.is_heard[0]
    assert not known[0, 1]
    assert not known[1, 0]
    assert known[0, 2]
    assert known[2, 0]


CROWD = 16
"""Robots within a metre of each other, where sound takes no time."""


CROWD_M = np.random.default_rng(1).uniform(-1.0, 1.0, (CROWD, 3))


def stay(one, place_m, steps, worlds):
    """The channel after so many steps of robots that stay where they are."""
    p_m = jnp.asarray(place_m, jnp.float32)

    def advance(number, key, memory):
        now = ChannelInput(
            key=jax.random.fold_in(key, number),
            number=number,
            p_m=p_m,
            grid=NOWHERE,
            make_packet=lambda: memory.in_flight.packet,
        )
        return channel.step(one, memory, now)[0]

    def run(keys):
        def step(memory, number):
            return jax.vmap(partial(advance, number))(keys, memory), None

        begin = jax.vmap(lambda _: channel.begin_channel(one, p_m))(keys)
        return jax.lax.scan(step, begin, jnp.arange(steps))[0]

    return jax.device_get(quickly(run)(jax.random.split(jax.random.key(5), worlds)))


def test_losses_come_as_often_as_the_link_says():
    link = LinkBudget(
        snr_db=30.0,
        bit_db=11.0,
        spreading=1.5,
        absorption_db_per_m=6e-3,
        bits=64,
        modulation="bpsk",
        fading="rayleigh",
    )
    one = shared(access.build_tdma(PACKET_S, 0.1, DT_S), link=link)
    frames, worlds = 25, 60
    end = stay(one, ROW_M, frames * 3 * one.access.slot, worlds)
    distance = np.linalg.norm(ROW_M[:, None] - ROW_M, axis=-1)
    success = np.where(np.eye(3), 0.0, link.success(distance, 0.0))
    assert 0.05 < success[0, 2] < 0.95  # or nothing is tested
    mean = end.n_received.mean(axis=0) / frames
    spread = np.sqrt(np.sum(success * (1 - success), axis=1) / (frames * worlds))
    assert np.all(np.abs(mean - success.sum(axis=1)) < 4.5 * spread + 1.0 / frames)


@pytest.mark.parametrize(("slotted", "interval_s"), [(False, 30.0), (True, 15.0)])
def test_aloha_gets_through_what_abramson_says(slotted, interval_s):
    """Throughput G exp(-2 G), in slots G exp(-G), G being the load of the 15 others on a receiver.

    Exactly, for as few robots as these: each other one must be silent for two packets, or in the
    slot. Robots rest for more than two packets, so no two begin in that time.
    """
    make = access.build_slotted_aloha if slotted else access.build_pure_aloha
    guard_s = -1e-4 if slotted else 1.3
    one = shared(make(PACKET_S, guard_s, DT_S, interval_s), sound_mps=1e9)
    steps, worlds = 12_000, 24
    end = stay(one, CROWD_M, steps, worlds)
    packets = steps * DT_S / PACKET_S
    rate = end.in_flight.sent.mean() / packets
    assert rate == pytest.approx(PACKET_S / interval_s, rel=0.05)
    load, through = rate * (CROWD - 1), end.n_received.mean() / packets
    vulnerable = rate if slotted else 2 * rate
    assert through == pytest.approx(load * (1 - vulnerable) ** (CROWD - 1), rel=0.05)
    assert through == pytest.approx(load * np.exp(-(1 if slotted else 2) * load), rel=0.08)


def test_who_sends_hears_nothing():
    """Two robots that send in every slot."""
    both = access.Aloha(chance=25, probability=1.0, slotted=True, rests=1, look=5)
    end, (came, _) = fly(shared(both), ROW_M[:2], 200)
    assert (end.in_flight.sent >= 7).all()
    assert not came.any()


def test_packets_that_come_in_together_are_lost_where_they_do():
    """Robots 0 and 1 send together; robot 2, far off, hears one after the other."""
    place = np.array([[0.0, 0.0, 0.0], [3000.0, 0.0, 0.0], [-3000.0, 0.0, 0.0]])
    always = access.Aloha(chance=200, probability=1.0, slotted=True, rests=1, look=5)
    _, (came, _) = fly(shared(always), place, 190)
    # 0 reaches 2 after 2 s, when that sends no more; 1 reaches it after 4 s.
    assert came[0, :, 2, 0].sum() == 1
    assert came[0, :, 2, 1].sum() == 1
    middle = np.array([[0.0, 0.0, 0.0], [3000.0, 0.0, 0.0], [1500.0, 4500.0, 0.0]])
    _, (came, _) = fly(shared(always), middle, 190)
    # As far from both: they come in together.
    assert not came[0, :, 2].any()
    assert came[0, :, 0, 1].sum() == 1
