"""Reach and capsules of links, by hand: of an arm that slides, and of no arm."""

import copy
import math

import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.files import parse_model
from angler_mjx.robot.vehicles import link_hull
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.library import load_vehicle

from .test_links import ARMED

MOUNT_M = (1.0, 0.0, 0.0)
"""Origin of the slide's frame from the base's centre of mass, where its joint is at its zero."""


@pytest.fixture
def slide():
    """Vehicle with a slide along y from -0.3 to 3 m about its zero, 0.75 m out at home; a fixed
    link on it."""
    data = copy.deepcopy(ARMED)
    del data["parameter_sets"]["hinsdale2023_identified"]  # of the shipped links
    link, joint = data["links"][1], data["joints"][0]
    origin = np.asarray(data["base"]["center_of_mass_m"])
    moving = link | {
        "name": "slide",
        "parent": "base",
        "position_m": list(origin + MOUNT_M),
        "capsules": [{"from_m": [0.0, 0.0, 0.0], "to_m": [0.0, 0.0, 2.0], "radius_m": 0.1}],
    }
    fixed = {key: link[key] for key in ("source", "rigid_body", "buoyancy", "water")} | {
        "name": "hook",
        "parent": "slide",
        "position_m": [0.0, 0.0, 0.5],
        "capsules": [{"from_m": [0.0, 0.0, 0.0], "to_m": [0.0, 0.0, -0.5], "radius_m": 0.2}],
    }
    limits = {"lower": 0.2, "upper": 3.5, "zero": 0.5, "home": 1.25}
    data["joints"] = [joint | limits | {"type": "prismatic", "axis": [0.0, 1.0, 0.0]}]
    data["links"] = [moving | {"joint": joint["name"]}, fixed]
    data["end_effector"]["link"] = "slide"
    return parse_model(VehicleConfig, data, source="slide.toml")


def test_a_slide_reaches_as_far_as_it_slides(slide):
    home_m = math.hypot(1.0, 0.75, 2.0) + 0.1
    assert link_hull.home_link_reach_m(slide) == pytest.approx(home_m)
    assert link_hull.max_link_reach_m(slide) == pytest.approx(1.0 + 3.0 + 2.0 + 0.1)


def test_a_vehicle_without_links_has_no_reach():
    config = load_vehicle("bluerov2_heavy")
    assert link_hull.home_link_reach_m(config) == 0.0
    assert link_hull.max_link_reach_m(config) == 0.0
    assert link_hull.build_link_capsules(config) is None


def test_capsules_are_padded_by_that_of_the_hull(slide):
    capsules = link_hull.build_link_capsules(slide)
    assert capsules.link.tolist() == [0, 1]
    hulls = [
        (jnp.full(3, 10.0 * k), jnp.full(3, 10.0 * k + 1.0), jnp.float32(10.0 * k + 2.0))
        for k in (1, 2)
    ]
    same, padded = link_hull.pad_link_capsules([capsules, None], hulls)
    for name in ("link", "a_m", "b_m", "r_m"):
        np.testing.assert_array_equal(getattr(same, name), getattr(capsules, name))
    assert padded.link.tolist() == [link_hull.ON_BASE] * 2
    np.testing.assert_array_equal(padded.a_m, np.full((2, 3), 20.0))
    np.testing.assert_array_equal(padded.b_m, np.full((2, 3), 21.0))
    np.testing.assert_array_equal(padded.r_m, [22.0, 22.0])
    assert link_hull.pad_link_capsules([None, None], hulls) == [None, None]
