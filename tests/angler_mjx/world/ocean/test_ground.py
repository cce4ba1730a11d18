"""Coasts and sea floors of files: which cells are rock, and that fleets stay in the water."""

import jax
import numpy as np
import pytest
import xarray
from scipy.interpolate import RegularGridInterpolator

from angler_experiments.ocean import headland
from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.world.config import WorldConfig
from angler_mjx.world.generate import generate_batch
from angler_mjx.world.ocean.floor import knots_below

SHAPE, CELL = (16, 16, 8), 2.0
PLACE = {"latitude": [50.518, 50.518], "longitude": [-2.45, -2.45]}
"""On the rim of the headland, 2 km north of the coast's middle."""
N = 6


def world(**keys):
    data = {"preset": "open", "shape": list(SHAPE), "cell_m": CELL, "depth_m": 1.0, **keys}
    return parse_model(WorldConfig, {"placement": "random", **data}, source="test")


def generated(config):
    made = generate_batch(config, np.array([0.4, 0.4]), 3, 0, N)
    return jax.tree.map(np.asarray, made)


def in_file(places_m):
    """Metres east and north of the middle of the coast, in the file's own flat terms."""
    lat, lon = PLACE["latitude"][0], PLACE["longitude"][0]
    return lat + places_m[1] / 111_243.0, lon + places_m[0] / 70_950.0


@pytest.fixture(scope="module")
def data(ocean_file):
    with xarray.open_dataset(ocean_file, engine="h5netcdf") as found:
        return found.load()


@pytest.fixture(scope="module")
def centres():
    return [
        low + CELL * (np.arange(n) + 0.5)
        for low, n in zip((-16.0, -16.0, -17.0), SHAPE, strict=True)
    ]


@pytest.fixture(scope="module")
def shallow(ocean_file):
    """A hundredth of the file's size: 3.2 km of it in 32 m."""
    grid = {"type": "grid", "file": str(ocean_file), "coast": True, **PLACE}
    grid["scale"] = {"space": 0.01, "speed": 0.1}
    return generated(world(currents=[grid]))


def test_land_of_the_file_is_rock(shallow, data, centres):
    x, y, z = 100.0 * centres[0], 100.0 * centres[1], centres[2]
    latitude, longitude = in_file((x, y))
    wet = np.isfinite(data.uo.values).all(axis=0) & np.isfinite(data.vo.values).all(axis=0)
    i, j, k = (
        np.abs(knots.values[:, None] - at[None]).argmin(axis=0)
        for knots, at in ((data.latitude, latitude), (data.longitude, longitude), (data.depth, -z))
    )
    want = ~wet[k[None, None, :], i[None, :, None], j[:, None, None]]
    assert 0.1 < want.mean() < 0.95
    # A nearest knot may be another where two are as near to a thousandth of a cell.
    assert np.mean(shallow.grid.occupied != want) < 0.01


def test_robots_begin_and_end_in_the_water_of_the_coast(shallow):
    assert shallow.valid.all()
    for at in (shallow.start_m, shallow.goal_m):
        cell = np.floor((at - np.array([-16.0, -16.0, -17.0])) / CELL).astype(int)
        inside = [shallow.grid.occupied[w][tuple(c)] for w in range(N) for c in cell[w]]
        assert not any(inside)
    assert np.all(shallow.density > 0.1)


def test_sea_floor_is_that_of_each_column(ocean_file, data, centres):
    grid = {
        "type": "grid",
        "file": str(ocean_file),
        **PLACE,
        "scale": {"space": 0.01, "speed": 0.1},
    }
    made = generated(world(currents=[grid], bathymetry={"file": str(ocean_file)}))
    x, y, z = 100.0 * centres[0], 100.0 * centres[1], centres[2]
    latitude, longitude = in_file((x, y))
    deep = np.nan_to_num(data.deptho.values, nan=-1.0)
    axes = (data.latitude.values, data.longitude.values)
    at = np.stack(np.meshgrid(latitude, longitude, indexing="ij"), axis=-1)
    depth = RegularGridInterpolator(axes, data.deptho.values)(at).T
    known = np.isfinite(depth)
    near = RegularGridInterpolator(axes, deep, method="nearest")(at).T
    rock = made.grid.occupied[0]
    column = rock.sum(axis=2)
    want = (-z[None, None, :] > depth[:, :, None]).sum(axis=2)
    sure = known & (near > 0)
    assert sure.sum() > 60
    # A cell whose middle is the sea floor to a thousandth may fall on either side.
    assert np.abs(column - want)[sure].max() <= 1
    assert np.mean(column != want, where=sure) < 0.02
    assert np.all(column[near < 0] == SHAPE[2]), "columns on land are rock to the top"
    assert np.all(np.diff(rock.astype(int), axis=2) <= 0), "nothing hangs over water"


def test_a_floor_alone_lies_at_places_of_its_own(ocean_file):
    made = generated(world(bathymetry={"file": str(ocean_file), "space": 0.02, "depth": 0.5}))
    columns = made.grid.occupied.sum(axis=(1, 2, 3))
    assert len(np.unique(columns)) > 3
    assert np.all(made.current == ())


def test_knots_are_carried_to_the_knot_below_of_another_axis():
    """Before, on, between and beyond its knots; where none is below, from the first."""
    below, between = knots_below(
        np.array([-2.0, 0.0, 5.0, 10.0, 35.0]), np.array([0.0, 10.0, 30.0])
    )
    np.testing.assert_array_equal(below, [0, 0, 0, 1, 2])
    np.testing.assert_array_equal(between, [-2.0, 0.0, 5.0, 0.0, 5.0])


def test_heights_are_read_as_depths(data, tmp_path):
    about = {"standard_name": "height_above_mean_sea_level", "units": "m"}
    height = data.deptho.copy(data=np.nan_to_num(-data.deptho.values, nan=7.0))
    height.attrs = about
    path = tmp_path / "height.nc"
    height.to_dataset(name="elevation").to_netcdf(path, engine="h5netcdf")
    place = {"latitude": [50.518, 50.518], "longitude": [-2.45, -2.45], "space": 0.01}
    one = generated(world(bathymetry={"file": str(path), **place}))
    plain = tmp_path / "plain.nc"
    data[["deptho"]].to_netcdf(plain, engine="h5netcdf")
    other = generated(world(bathymetry={"file": str(plain), **place}))
    np.testing.assert_array_equal(one.grid.occupied, other.grid.occupied)
    assert one.grid.occupied.any()


def test_files_that_do_not_lie_together_are_refused(ocean_file, tmp_path):
    grid = {"type": "grid", "file": str(ocean_file)}
    with pytest.raises(ConfigError, match='two of type "grid"'):
        world(currents=[grid, grid])
    with pytest.raises(ConfigError, match=r"bathymetry\.latitude: the sea floor lies where"):
        world(currents=[grid], bathymetry={"file": str(ocean_file), "latitude": [50.56, 50.58]})
    far = headland.build_dataset(16)
    far = far.assign_coords(latitude=("latitude", far.latitude.values + 9, far.latitude.attrs))
    far.to_netcdf(tmp_path / "far.nc", engine="h5netcdf")
    with pytest.raises(ConfigError, match="give files of one area"):
        world(currents=[grid], bathymetry={"file": str(tmp_path / "far.nc")})
    far[["uo"]].to_netcdf(tmp_path / "none.nc", engine="h5netcdf")
    with pytest.raises(ConfigError, match="no variable has the standard_name sea_floor_depth"):
        world(bathymetry={"file": str(tmp_path / "none.nc")})
    with pytest.raises(ConfigError, match=r"uo has the units 'm s-1': must be m or km"):
        world(bathymetry={"file": str(ocean_file), "variable": "uo"})
