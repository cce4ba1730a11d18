"""Problems of MovingAI, db-CBS and dynobench as scenarios, in files as others write them."""

import re
from pathlib import Path

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.report.interop.problem_files.import_problem import import_problem
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.world.config import resolve_world

EXAMPLES = Path(__file__).parents[5] / "docs" / "examples" / "problems"
MAPS = {
    "gates.map.scen": 4,
    "pillars.map.scen": 6,
    "rooms.map.scen": 4,
    "tunnel.3dscen": 2,
    "cross.3dscen": 3,
}
BOXES = {"swap.yaml": 2, "bay.yaml": 3, "columns.yaml": 4, "window.yaml": 2, "drones.yaml": 4}


def is_rock(scenario, position_m):
    """Whether a position is in a cell of rock or in a box, worked out from the scenario's table."""
    recipe = resolve_world(scenario.world)
    index = np.floor((np.array(position_m) - recipe.origin_m) / recipe.cell_m).astype(int)
    in_cells = hasattr(recipe.rule, "cells") and bool(recipe.rule.cells()[tuple(index)])
    return (
        in_cells
        or any(
            np.all(np.abs(np.array(position_m) - box.position_m) < np.array(box.size_m) / 2)
            for box in scenario.world.obstacles.explicit
        )
        if scenario.world.obstacles
        else in_cells
    )


@pytest.mark.parametrize(("name", "robots"), (MAPS | BOXES).items())
def test_every_example_becomes_a_scenario_whose_robots_start_in_water(tmp_path, name, robots):
    imported = import_problem(EXAMPLES / name, robots=robots, scale_m=3.0)
    (tmp_path / "a.toml").write_text(imported.text)
    scenario = load_scenario(tmp_path / "a.toml")
    assert scenario == imported.scenario
    assert len(scenario.members()) == robots
    for position in (*scenario.world.start_m, *scenario.world.goal_m):
        assert not is_rock(scenario, position)
    assert all(f"# {note}" in imported.text for note in imported.notes)


def test_a_map_is_turned_so_that_its_first_row_is_north():
    scenario = import_problem(EXAMPLES / "gates.map.scen", robots=1, scale_m=2.0, layers=5).scenario
    world = scenario.world
    assert (world.shape, world.cell_m) == ((16, 8, 5), 2.0)
    cells = world.rule.cells()
    assert cells.shape == (16, 8, 5)
    # Row 2 of the map, "@@@@@@..@@@@@@@@", is the third from the north.
    assert np.flatnonzero(~cells[:, 5, 0]).tolist() == [6, 7]
    assert np.flatnonzero(~cells[:, 2, 4]).tolist() == [10, 11]
    assert cells.sum() == 5 * (14 + 14)
    # Cell (1, 0) of the map, to (14, 7): 16 m and 8 m are half the edges, a cell is 2 m.
    assert world.start_m[0] == pytest.approx((-16 + 3, 8 - 1, -2 - 5))
    assert world.goal_m[0] == pytest.approx((-16 + 29, 8 - 15, -2 - 5))


def test_voxels_and_their_reverse_keep_their_axes():
    tunnel = import_problem(EXAMPLES / "tunnel.3dscen", robots=1, scale_m=1.0).scenario.world
    cells = tunnel.rule.cells()
    assert cells.shape == (10, 6, 5)
    assert {tuple(row) for row in np.argwhere(~cells[5])} == {(2, 2), (2, 3), (3, 2), (3, 3)}
    assert cells.sum() == 26
    assert tunnel.start_m[0] == pytest.approx((-5 + 1.5, -3 + 1.5, -2 - 5 + 1.5))
    assert tunnel.goal_m[0] == pytest.approx((-5 + 8.5, -3 + 4.5, -2 - 5 + 3.5))
    cross = import_problem(EXAMPLES / "cross.3dscen", robots=3).scenario.world.rule.cells()
    assert (~cross).sum() == 12 * 9 + 3 * 7 * 5 - 3 * 9


def test_a_region_is_cut_out_and_rows_outside_are_dropped(tmp_path):
    imported = import_problem(
        EXAMPLES / "rooms.map.scen", robots=1, region=(0, 0, 10, 9), scale_m=1.0
    )
    world = imported.scenario.world
    assert world.shape == (11, 10, 3)
    # The fourth row, (5, 4) to (9, 6), is the first inside.
    assert world.start_m[0][:2] == pytest.approx((-5.5 + 5.5, 5 - 4.5))
    assert world.goal_m[0][:2] == pytest.approx((-5.5 + 9.5, 5 - 6.5))
    assert any("outside the region" in str(note) and ":2" in str(note) for note in imported.notes)


def test_boxes_keep_their_sizes_and_the_bounds_become_walls():
    world = import_problem(EXAMPLES / "bay.yaml", scale_m=2.0, layers=4).scenario.world
    # 9.5 x 6 units of 2 m: 19 m are 13 cells, of which 12 m take 8.2.
    assert world.cell_m == pytest.approx(19.0 / 13)
    assert world.shape == (13, 9, 4)
    boxes = world.obstacles.explicit
    assert len(boxes) == 2 + 2
    assert boxes[0].position_m[:2] == pytest.approx((2 * 2 - 9.5, 1 * 2 - 6.0))
    assert boxes[0].size_m == pytest.approx((8.0, 4.0, 4 * world.cell_m))
    faces = sorted(
        box.position_m[1] + side * box.size_m[1] / 2 for box in boxes[2:] for side in (-1, 1)
    )
    assert faces[1:3] == pytest.approx([-6.0, 6.0])
    assert faces[0] < -9 * world.cell_m / 2
    assert world.start_m[0][:2] == pytest.approx((1 * 2 - 9.5, 4 * 2 - 6.0))


def test_a_problem_in_space_needs_no_walls_where_cells_fit():
    world = import_problem(EXAMPLES / "window.yaml", scale_m=3.0).scenario.world
    assert world.shape == (12, 8, 6)
    assert len(world.obstacles.explicit) == 4
    # 18 x 12 x 9 m from 2 m below the surface; z of the file is up from its floor.
    assert world.start_m[0] == pytest.approx((-2.4 * 3, -1 * 3, -11 + 1 * 3))
    hole = world.obstacles.explicit[2]
    assert hole.position_m == pytest.approx((0.0, 0.0, -11 + 0.4 * 3))
    assert hole.size_m == pytest.approx((1.2, 3.0, 2.4))


def copy(tmp_path, *names):
    for name in names:
        (tmp_path / name).write_text((EXAMPLES / name).read_text())
    return tmp_path / names[0]


@pytest.mark.parametrize(
    ("file", "old", "new", "message"),
    [
        ("gates.map.scen", "version 1", "version 7", r"gates.map.scen:1: .*must be version 1"),
        ("gates.map.scen", "gates.map\t16", "gates.map\t32", r"scen:2: .*scaled maps are not read"),
        ("gates.map.scen", "gates.map\t", "other.map\t", r"there is no .*other.map: give --map"),
        ("gates.map.scen", "\t1\t0\t", "\tone\t0\t", r"scen:2: .*4 numbers from its field 5"),
        ("gates.map", "type octile", "kind octile", r"gates.map:1: .*must begin with"),
        ("gates.map", "@@@@@@..", "@@@@@@.", r"gates.map:7: .*must have 16 letters, has 15"),
        ("gates.map", "@@@@@@..", "@@@@@@X.", r"letters 'X'; known are"),
        ("gates.map", "................", "@...............", None),
        ("gates.map", "height 8", "height 9", r"must have 9 rows"),
        ("tunnel.3dmap", "voxel", "octree", r"tunnel.3dmap:1: .*voxel X Y Z"),
        ("tunnel.3dmap", "\n5 0 0", "\n5 0 9", r"tunnel.3dmap:2: .*outside the map"),
        ("tunnel.3dscen", "1 1 1 8", "5 0 0 8", r"tunnel.3dscen:3: .*its start is blocked"),
        ("bay.yaml", "min:", "low:", r"environment.min = None: must be a list of numbers"),
        ("bay.yaml", "[9.5, 6]", "[9.5, nan]", r"environment.max"),
        ("bay.yaml", "[9.5, 6]", "[9.5, -6]", r"max must be above min"),
        ("bay.yaml", "type: box", "type: octomap", r"obstacles\[0\]: type is 'octomap'"),
        ("bay.yaml", "[4.0, 2.0]", "[4.0, 0]", r"obstacles\[0\].size: must be above 0"),
        ("bay.yaml", "[4.0, 2.0]", "[4.0, 2.0, 1.0]", r"size = \[4.0, 2.0, 1.0\]: .*2 numbers"),
        ("bay.yaml", "start: [1, 4", "start: [-1, 4", r"robots\[0\].start: lies outside"),
        ("bay.yaml", "robots:", "agents:", r"robots: must be a list"),
        ("bay.yaml", "environment:", "- environment:", r"bay.yaml"),
    ],
)
def test_faults_name_file_line_and_what_must_be(tmp_path, file, old, new, message):
    names = {"gates": ("gates.map.scen", "gates.map"), "tunnel": ("tunnel.3dscen", "tunnel.3dmap")}
    path = copy(tmp_path, *names.get(file.split(".")[0], (file,)))
    text = (tmp_path / file).read_text()
    assert old in text
    (tmp_path / file).write_text(text.replace(old, new, 1))
    if message is None:  # a cell that nobody starts in
        assert import_problem(path, robots=1)
        return
    with pytest.raises(ConfigError, match=message):
        import_problem(path, robots=1 if path.suffix != ".yaml" else None)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"path": "gates.map.scen"}, "give --robots"),
        ({"path": "gates.map.scen", "robots": 9}, "has 4 rows in the region, --robots 9"),
        ({"path": "gates.map.scen", "robots": 1, "region": (0, 0, 9)}, "must be 4 numbers"),
        ({"path": "gates.map.scen", "robots": 1, "region": (0, 0, 16, 7)}, "must lie in the map"),
        ({"path": "bay.yaml", "robots": 4}, "has 3 robots, --robots 4"),
        ({"path": "bay.yaml", "region": (0, 0, 1, 1)}, "are for MovingAI's files"),
        ({"path": "bay.yaml", "scale_m": 0.0}, "--scale-m 0: must be above 0"),
        ({"path": "bay.yaml", "layers": 1}, "--layers 1: must be 2 to 128"),
        ({"path": "gates.map", "robots": 1}, "problems are read from .scen, .3dscen, .yaml"),
        ({"path": "drones.yaml", "scale_m": 40.0}, "a world has at most 128 along each axis"),
    ],
)
def test_flags_that_do_not_fit_are_refused(arguments, message):
    path = EXAMPLES / arguments.pop("path")
    with pytest.raises(ConfigError, match=re.escape(message)):
        import_problem(path, **arguments)
