"""Arrays of links and their topology, by hand: of an arm with a branch and two cylinders."""

import copy

import numpy as np
import pytest

from angler_mjx.files import parse_model
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.link_params import STRIPS, build_links, build_tree

from .test_links import ARMED

ADDED = np.diag([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]).tolist()
CYLINDERS = (
    {"from_m": [0.1, 0.0, 0.0], "to_m": [0.4, 0.4, 0.0], "radius_m": 0.02}
    | {"normal_drag": 1.2, "axial_drag": 0.05, "added_mass": 1.0},
    {"from_m": [0.0, 0.0, 0.3], "to_m": [0.0, 0.0, 0.1], "radius_m": 0.03}
    | {"normal_drag": 0.9, "axial_drag": 0.0, "added_mass": 0.5},
)


def build_config(*links):
    """Return the shipped vehicle with other links: (name, parent, joint, water)."""
    data = copy.deepcopy(ARMED)
    del data["parameter_sets"]["hinsdale2023_identified"]  # of the shipped links
    joints = {joint["name"]: joint for joint in data["joints"]}
    link = {key: data["links"][1][key] for key in ("source", "rigid_body", "buoyancy", "water")}
    data["links"] = [
        link
        | {"name": name, "parent": parent, "position_m": [0.1, 0.0, 0.0]}
        | ({} if joint is None else {"joint": joint})
        | {"water": {"source": "Made up"} | water}
        for name, parent, joint, water in links
    ]
    data["joints"] = [joints[joint] for _, _, joint, _ in links if joint is not None]
    data["end_effector"]["link"] = links[0][0]
    return parse_model(VehicleConfig, data, source="made_up.toml")


@pytest.fixture(scope="module")
def branched():
    """A link with cylinders that turns, a fixed one on it, another that turns on that one, and
    one beside them on the base."""
    return build_config(
        ("root", "base", "axis_e", {"cylinders": list(CYLINDERS)}),
        ("plate", "root", None, {"added_mass": ADDED}),
        ("tip", "plate", "axis_d", {"cylinders": [CYLINDERS[1]]}),
        ("lamp", "base", "axis_c", {}),
    )


def test_joints_move_all_links_beyond_them(branched):
    tree = build_tree(branched)
    assert tree.parents == (-1, 0, 1, -1)
    assert tree.joints == (0, -1, 1, 2)
    moves = [[True, False, False], [True, False, False], [True, True, False], [False, False, True]]
    assert tree.moves.tolist() == moves
    assert tree.carries.tolist() == [[False] * 3, [True, False, False], [False] * 3]


def test_cylinders_are_laid_out_in_strips(branched):
    links = build_links(branched, None)
    along, upright = np.array([0.6, 0.8, 0.0]), np.array([0.0, 0.0, -1.0])
    expected = {
        "cylinder_m": [[0.25, 0.2, 0.0], [0.0, 0.0, 0.2]],
        "cylinder_axis": [along, upright],
        "cylinder_length_m": [0.5, 0.2],
        "normal_area_m2": [0.5 * 1.2 * 0.04 * 0.5 / STRIPS, 0.5 * 0.9 * 0.06 * 0.2 / STRIPS],
        "axial_area_m2": [0.5 * 0.05 * np.pi * 0.04 * 0.5 / STRIPS, 0.0],
    }
    for name, rows in expected.items():
        np.testing.assert_allclose(getattr(links, name)[0], rows, rtol=1e-6, err_msg=name)
        np.testing.assert_allclose(getattr(links, name)[2, 0], rows[1], rtol=1e-6, err_msg=name)
    for name in ("normal_area_m2", "axial_area_m2", "cylinder_length_m"):
        np.testing.assert_array_equal(getattr(links, name)[1::2], 0.0, err_msg=name)
        np.testing.assert_array_equal(getattr(links, name)[2, 1], 0.0, err_msg=name)


def test_added_mass_is_that_of_the_file_beside_the_cylinders(branched):
    links = build_links(branched, None)
    np.testing.assert_array_equal(links.M_A[1], ADDED)
    np.testing.assert_array_equal(links.M_A[::2], 0.0)
    np.testing.assert_array_equal(links.added_volume[1::2], 0.0)
    volume = 0.5 * np.pi * 0.03**2 * 0.2
    np.testing.assert_allclose(
        links.added_volume[2, :3, :3], volume * np.diag([1.0, 1.0, 0.0]), rtol=1e-6
    )
