"""World configs: what a file may say, what comes of it, and what is refused."""

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.world import presets
from angler_mjx.world.config import WorldConfig, resolve_world


def recipe(**data):
    return resolve_world(parse_model(WorldConfig, data, source="test"))


@pytest.mark.parametrize("name", presets.list_presets())
def test_every_preset_is_complete(name):
    world = recipe(preset=name)
    assert hash(world) == hash(recipe(preset=name))
    top = world.origin_m[2] + world.shape[2] * world.cell_m
    assert top == pytest.approx(-presets.load_preset(name).depth_m)
    middle = np.array(world.origin_m[:2]) + 0.5 * np.array(world.size_m[:2])
    np.testing.assert_allclose(middle, 0, atol=1e-12)  # rounding of float64


def test_the_floor_is_the_bottom_of_the_grid_unless_said_otherwise():
    assert recipe(preset="reef").floor_z_m == recipe(preset="reef").origin_m[2]
    assert recipe(preset="reef", floor_depth_m=40.0).floor_z_m == -40.0


def test_the_papers_generator_is_a_preset():
    world = recipe(preset="angler2024")
    assert world.shape == (12, 12, 12)
    assert (world.cell_m, world.fill, world.min_obstacles) == (1.5, 0.045, 10)
    assert (world.rule.die_below, world.rule.born_above, world.rule.steps) == (2, 12, 1)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        ({"preset": "reeef"}, ("preset = 'reeef'", "no preset")),
        ({"density": 0.9}, ("density = 0.9", "reaches")),
        ({"density": 0.0}, ("density = 0.0", "reaches")),
        ({"density": 0.1, "fill": 0.1}, ("density = 0.1", "fill = 0.1")),
        ({"preset": "open", "density": 0.1}, ("density = 0.1", "open")),
        ({"shape": [4, 4, 4], "density": 0.06}, ("shape = (4, 4, 4)",)),
        ({"rule": {"type": "automaton", "die_below": 3, "born_above": 9, "steps": 1}}, ("fill",)),
        ({"preset": "corridor", "rule": {"type": "walls", "count": 8}}, ("rule.count = 8",)),
        ({"rule": {"type": "walls", "gate_cells": 17}}, ("rule.gate_cells = 17",)),
        ({"floor_depth_m": 3.0}, ("floor_depth_m = 3.0",)),
        ({"start_m": [[0, 0, -5]], "goal_m": []}, ("start_m has 1",)),
        ({"placement": "given"}, ("start_m",)),
        ({"cell_m": float("nan")}, ("cell_m",)),
        ({"shape": [16, 16]}, ("shape",)),
        ({"depht_m": 1.0}, ("depht_m", "unknown key")),
    ],
)
def test_what_cannot_be_used_is_named(data, words):
    with pytest.raises(ConfigError) as caught:
        recipe(**data)
    for word in words:
        assert word in str(caught.value)
