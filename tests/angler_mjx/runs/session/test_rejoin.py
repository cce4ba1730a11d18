"""The way back to a plan: straight where it can be, around rock where not, and clear of it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.runs.session.rejoin import RejoinPaths
from angler_mjx.runs.session.robot_plan import RobotPlan
from angler_mjx.world import generate
from angler_mjx.world.config import WorldConfig, resolve_world

from ...compiling import quickly

CLEARANCE_M, SPEED_MPS = 0.5, 0.5
PLAN = RobotPlan(
    time_s=np.array([0.0, 20.0, 36.0]),
    position_m=np.array([[-5.0, 4.0, -8.0], [5.0, 4.0, -8.0], [5.0, -4.0, -8.0]]),
)


@pytest.fixture(scope="module")
def water():
    """An open cube of 12^3 cells of 1.5 m: x and y from -9 to 9 m, z from -20 to -2 m."""
    recipe = resolve_world(WorldConfig(preset="open", shape=(12, 12, 12), placement="random"))
    sample_world = quickly(
        lambda key: generate.generate_world(recipe, recipe.numbers(60.0), jnp.array([0.3]), key)
    )
    return sample_world(jax.random.key(0))


def with_rock(water, *blocks):
    occupied = np.zeros((12, 12, 12), bool)
    for x, y, z in blocks:
        occupied[x, y, z] = True
    return replace(water, grid=replace(water.grid, occupied=jnp.asarray(occupied)))


def clearance(environment, plan):
    """Least distance of a path to rock: dense points against every box, in numpy."""
    origin = np.asarray(environment.grid.origin_m, float)
    low = origin + 1.5 * np.argwhere(np.asarray(environment.grid.occupied))
    points = plan.at(np.linspace(0.0, plan.time_s[-1], 2000))
    gap = np.maximum(low - points[:, None], points[:, None] - (low + 1.5)).clip(0.0)
    return np.linalg.norm(gap, axis=-1).min()


REST = np.zeros(3)


def test_it_goes_straight_to_the_nearest_point_that_is_still_ahead(water):
    rejoin_paths = RejoinPaths(water)
    p = np.array([-2.0, 1.0, -8.0])
    back = rejoin_paths.plan_rejoin(p, REST, PLAN, 4.0, CLEARANCE_M, SPEED_MPS)
    np.testing.assert_allclose(back.position_m[0], p)
    np.testing.assert_allclose(back.position_m[-1], PLAN.position_m[-1])
    # Straight across to (-2, 4), which the plan passes at 6 s, then along: 64 looks in 32 s.
    points_m = back.position_m[:, :2]
    np.testing.assert_allclose(points_m[:, 0].min(), -2.0, atol=0.3)
    assert back.time_s[-1] == pytest.approx(36.0 - 6.0 + 6.0 + 1.0, abs=0.7)
    # Once it has passed the nearest place, it does not go back to it.
    later = rejoin_paths.plan_rejoin(p, REST, PLAN, 12.0, CLEARANCE_M, SPEED_MPS)
    assert np.all(np.diff(later.position_m[:, 0]) > -1e-6)


def test_it_sets_out_evenly_from_rest_and_keeps_its_speed_otherwise(water):
    rejoin_paths = RejoinPaths(water)
    p = np.array([-2.0, 1.0, -8.0])
    for velocity, first in ((REST, 0.0), (np.array([0.0, 0.5, 0.0]), 0.5)):
        back = rejoin_paths.plan_rejoin(p, velocity, PLAN, 6.0, CLEARANCE_M, SPEED_MPS)
        speed = np.linalg.norm(np.diff(back.position_m, axis=0), axis=1) / np.diff(back.time_s)
        assert np.all(np.diff(back.time_s) > 0)
        assert speed.max() <= SPEED_MPS + 1e-6
        # A piece of a ramp of eight has the mean of its ends' speeds; 16 to a step.
        assert speed[0] == pytest.approx(first, abs=0.05)


def test_it_goes_around_a_wall(water):
    wall = with_rock(water, (slice(0, 10), 6, slice(None)))  # y from 0 to 1.5, open at large x
    p = np.array([-4.0, -3.0, -8.0])
    back = RejoinPaths(wall).plan_rejoin(p, REST, PLAN, 0.0, CLEARANCE_M, SPEED_MPS)
    np.testing.assert_allclose(back.position_m[0], p)
    assert clearance(wall, back) >= CLEARANCE_M - 1e-3
    # The nearest point of the plan lies behind the wall: straight to it would run through rock.
    straight = RobotPlan(time_s=np.array([0.0, 1.0]), position_m=np.array([p, [-4.0, 4.0, -8.0]]))
    assert clearance(wall, straight) == 0.0


def test_it_finds_a_hole_by_its_cells(water):
    """The plan on one side only, the way through a hole that no straight line passes."""
    wall = np.zeros((12, 12, 12), bool)
    wall[:, 6, :] = True
    wall[10, 6, 2] = False
    holed = replace(water, grid=replace(water.grid, occupied=jnp.asarray(wall)))
    plan = replace(PLAN, time_s=PLAN.time_s[:2], position_m=PLAN.position_m[:2])
    back = RejoinPaths(holed).plan_rejoin(
        np.array([-4.0, -3.0, -8.0]), REST, plan, 0.0, CLEARANCE_M, SPEED_MPS
    )
    assert clearance(holed, back) >= CLEARANCE_M - 1e-3
    inside = back.at(np.linspace(0.0, back.time_s[-1], 4000))
    through = inside[(inside[:, 1] > 0.0) & (inside[:, 1] < 1.5)]
    assert len(through) > 0
    assert np.all((through[:, 0] > 6.0) & (through[:, 0] < 7.5))


def test_who_is_shut_in_has_no_way_back(water):
    shut = with_rock(water, (slice(None), 6, slice(None)))
    plan = replace(PLAN, time_s=PLAN.time_s[:2], position_m=PLAN.position_m[:2])
    p = np.array([-4.0, -3.0, -8.0])
    assert RejoinPaths(shut).plan_rejoin(p, REST, plan, 0.0, CLEARANCE_M, SPEED_MPS) is None


def test_who_is_close_to_rock_leaves_it_at_its_own_distance(water):
    """0.3 m from a wall a robot that keeps 0.5 m from rock would find no way at all."""
    wall = with_rock(water, (slice(None), 2, slice(None)))  # y from -6 to -4.5
    p = np.array([0.0, -4.2, -8.0])
    back = RejoinPaths(wall).plan_rejoin(p, REST, PLAN, 0.0, CLEARANCE_M, SPEED_MPS)
    assert clearance(wall, back) == pytest.approx(0.3, abs=1e-3)
