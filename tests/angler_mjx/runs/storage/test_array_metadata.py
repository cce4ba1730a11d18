"""What arrays on disk say of themselves: axes, unit and meaning, of all that can be written."""

from dataclasses import fields

import jax
import numpy as np
import pytest
import zarr

from angler_mjx.runs.storage import array_metadata, environments, trajectory_layout
from angler_mjx.sim.information import ObstacleInformation
from angler_mjx.world import currents
from angler_mjx.world.obstacles import BOX, bounding_radius

from ...report.conftest import make_environment

COMPONENTS = (
    currents.Uniform,
    currents.GaussMarkov,
    currents.Vortices,
    currents.Rankine,
    currents.DoubleGyre,
    currents.DepthProfile,
    currents.Tide,
    currents.Gridded,
)
SI = {"m", "s", "kg", "rad", "N", "W", "J", "Pa", "us", "m/s", "m/s^2", "rad/s", "rad/s^2", "m^3"}
ENDS = {
    "_m": "m", "_s": "s", "_mps": "m/s", "_mps2": "m/s^2", "_rad": "rad", "_radps": "rad/s",
    "_w": "W", "_kg": "kg", "_m3": "m^3", "_kgm2": "kg m^2", "_m2ps": "m^2/s", "_1ps": "1/s",
    "_us": "us", "_j": "J", "_n": "N", "_hz": "Hz", "_v": "V", "_db": "dB",
}  # fmt: skip
"""Units that the ends of names claim (docs/reference/notation.md)."""


def claimed(name):
    """Unit that a name claims; None where its end claims none."""
    ends = [end for end in ENDS if name.endswith(end)]
    return ENDS[max(ends, key=len)] if ends else None


@pytest.mark.parametrize("kind", COMPONENTS)
def test_every_array_of_a_current_has_a_meaning_and_the_unit_of_its_name(kind):
    names = [f.name for f in fields(kind) if not f.metadata.get("static") and f.name != "numbers"]
    for name in names:
        about = array_metadata.describe_array(f"current/1/{name}", ("Uniform", kind.__name__))
        assert about.text.startswith(f"{kind.__name__}: ")
        assert about.unit == (claimed(name) or about.unit)
        if claimed(name) is None:
            assert about.unit in ("1", "1/m, 1/s")


def test_units_of_names_are_those_of_the_arrays():
    held = {name: kind.unit for name, kind in trajectory_layout.ARRAYS.items()}
    held |= {name: about.unit for name, about in array_metadata._WORLD.items()}
    for name, unit in held.items():
        wanted = claimed(name.rsplit("/", 1)[-1])
        assert wanted is None or unit == wanted, name
    assert all(kind.text and kind.unit for kind in trajectory_layout.ARRAYS.values())


def test_an_array_without_a_meaning_is_not_written():
    with pytest.raises(KeyError):
        array_metadata.describe_array("obstacles/colour")


def test_sizes_of_obstacles_are_half_edges_and_say_so(tmp_path):
    group = zarr.open_group(tmp_path / "worlds.zarr", mode="w")
    made = make_environment(np.random.default_rng(1), (4, 4, 4))
    batch = jax.tree.map(lambda leaf: np.asarray(leaf)[None], made)
    environments.create_arrays(group, batch, 1, 1)
    environments.write_batch(group, 0, batch)
    for _, node in group.members(max_depth=None):
        if isinstance(node, zarr.Array):
            assert {"unit", "description"} <= set(node.attrs), node.name
            assert len(node.metadata.dimension_names) == node.ndim, node.name
    size = group["obstacles/size_m"]
    assert "half edges" in size.attrs["description"]
    # What it says is so: the sphere about a box reaches its corners, half an edge away each.
    body = environments.read_environments(group, 0).obstacles
    box = np.flatnonzero(np.asarray(body.kind) == BOX)
    radius = np.asarray(jax.vmap(bounding_radius)(body.kind, body.size_m))
    corner = np.linalg.norm(np.asarray(body.size_m), axis=1)
    assert box.size
    np.testing.assert_allclose(radius[box], corner[box], rtol=1e-6)


def test_the_former_name_keeps_its_meaning_and_warns():
    held = {f.name: None for f in fields(ObstacleInformation) if f.name != "some_stand"}
    known = ObstacleInformation(**{**held, "half_size_m": np.array([[0.5, 1.0, 1.5]])})
    with pytest.warns(DeprecationWarning, match="half edges of boxes"):
        old = known.size_m
    assert old is known.half_size_m
