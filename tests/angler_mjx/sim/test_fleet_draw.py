"""Which variant a robot is: by its weights, by its own number, in every world anew.

And what the variants that robots can be have in common.
"""

import jax
import numpy as np
import pytest

from angler_mjx.sim import fleet
from angler_mjx.sim.fleet import Member, Variant

from ..independence import assert_uncorrelated

N = 4000
SETS = ("wu2018", "von_benzon2022")


def mix(vehicle, weights, names=SETS):
    kinds = tuple(Variant(vehicle=vehicle, parameter_set=s, battery_v=16.0) for s in names)
    return Member(variants=kinds, weights=weights, cruise_speed_mps=0.5)


TEAM = [mix("bluerov2_heavy", (1.0, 2.0)), *[mix("bluerov2_heavy", (1.0, 1.0))] * 2]


def draws(members, seed=0):
    """Variants [N, robot] of worlds."""
    kinds = fleet.build_fleet(members, multibody=False)
    keys = jax.vmap(jax.random.fold_in, (None, 0))(jax.random.key(seed), np.arange(N))
    return np.asarray(jax.jit(jax.vmap(lambda key: fleet.sample_variants(kinds, key)[0]))(keys))


@pytest.fixture(scope="module")
def drawn():
    return draws(TEAM)


def test_variants_come_as_often_as_their_weights_say(drawn):
    # A share p of N draws has a standard deviation of sqrt(p (1 - p) / N); five of those.
    for robot, share in enumerate((2 / 3, 1 / 2, 1 / 2)):
        off = abs(np.mean(drawn[:, robot] == 1) - share)
        assert off < 5 * np.sqrt(share * (1 - share) / N)


def test_robots_worlds_and_seeds_are_independent(drawn):
    other = draws(TEAM, seed=1)
    assert_uncorrelated(np.concatenate([drawn[1:], drawn[:-1], other[1:]], axis=1))


@pytest.mark.parametrize("vehicle", ["bluerov2_heavy", "bluerov2"])
def test_a_robot_more_changes_nothing_for_the_others(drawn, vehicle):
    """One of a vehicle that the fleet has already, and one that brings variants of its own."""
    name = "wu2018" if vehicle == "bluerov2_heavy" else None
    more = Variant(vehicle=vehicle, parameter_set=name or first_set(vehicle), battery_v=14.0)
    last = Member(variants=(more,), weights=(1.0,), cruise_speed_mps=0.5)
    np.testing.assert_array_equal(draws([*TEAM, last])[:, :3], drawn)


def first_set(vehicle):
    return sorted(fleet.library.load_vehicle(vehicle).parameter_sets)[0]


def test_what_is_the_same_in_all_that_robots_can_be_is_known_and_nothing_else():
    """A fleet of three groups: one of two variants, one of one, one of another vehicle."""
    heavy, light = "bluerov2_heavy", "bluerov2"
    team = [
        *[mix(heavy, (1.0, 1.0))] * 2,
        mix(light, (1.0,), (first_set(light),)),
        mix(heavy, (1.0,), SETS[1:]),
    ]
    kinds = fleet.build_fleet(team, multibody=False)
    possible = ([0, 1], [2], [1])
    assert [(group.first, group.count) for group in kinds.groups] == [(0, 2), (2, 1), (3, 1)]
    seen = set()
    for group, variants in zip(kinds.groups, possible, strict=True):
        assert group.variant in variants
        leaves = jax.tree.leaves(kinds.control)
        for leaf, letters, shared in zip(leaves, group.sameness, group.shared, strict=True):
            table = np.asarray(leaf, float).reshape(len(leaf), -1)[variants]
            values = [set(column) for column in table.T.tolist()]
            assert letters == "".join(
                "z" if one == {0.0} else "s" if len(one) == 1 else "v" for one in values
            )
            seen |= set(letters)
            # Tables of thrust at 201 signals are read where they lie.
            told = tuple(one.pop() if len(one) == 1 else 0.0 for one in values)
            assert shared == (() if leaf.shape[1:] == (201,) else told)
        assert sum(map(len, group.shared)) > 200
    assert seen == set("zsv")
