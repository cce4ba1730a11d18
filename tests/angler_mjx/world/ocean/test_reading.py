"""NetCDF files: what is read of them by CF conventions, and what is refused with which words."""

import numpy as np
import pytest
import xarray

from angler_experiments.ocean import headland
from angler_mjx.errors import ConfigError
from angler_mjx.world import ocean
from angler_mjx.world.ocean import cf

NONE = {"u": None, "v": None, "w": None}


@pytest.fixture(scope="module")
def small():
    return headland.build_dataset(10).isel(time=slice(0, 4), depth=slice(0, 3))


def written(data, tmp_path, **options):
    path = tmp_path / "field.nc"
    data.to_netcdf(path, **{"engine": "h5netcdf", **options})
    return str(path)


def field_of(data, tmp_path, **names):
    return ocean.load_field(written(data, tmp_path), {**NONE, **names})


def test_field_has_the_numbers_of_the_file(small, tmp_path):
    field = field_of(small, tmp_path)
    assert field.shape == (10, 10, 3, 4, 2)
    assert field.degrees
    assert field.begin == "2024-06-01T00:00:00"
    want = np.stack([small.uo.values, small.vo.values], axis=-1).transpose(2, 3, 1, 0, 4)
    np.testing.assert_array_equal(field.wet, np.isfinite(want).all(axis=(3, 4)))
    assert 0.3 < field.wet.mean() < 0.8
    np.testing.assert_allclose(field.values[field.wet], want[field.wet], rtol=1e-6)
    assert np.all(np.isfinite(field.values))
    np.testing.assert_allclose(field.knots[3], 3600.0 * np.arange(4))
    np.testing.assert_array_equal(field.knots[2], small.depth)


def test_dry_knots_have_the_values_of_the_nearest_water(small, tmp_path):
    field = field_of(small, tmp_path)
    y, x = (111.2 * field.knots[0], 70.8 * field.knots[1])
    for i, j in np.argwhere(~field.wet[:, :, 1]):
        wet = np.argwhere(field.wet[:, :, 1])
        far = np.hypot(y[wet[:, 0]] - y[i], x[wet[:, 1]] - x[j])
        nearest = wet[far < far.min() + 1e-3]
        same = [np.array_equal(field.values[i, j, 1], field.values[a, b, 1]) for a, b in nearest]
        assert any(same)


def packed(small, **_):
    """As published: whole numbers, cm/s, north first, seconds, another order of axes."""
    data = small.transpose("longitude", "time", "latitude", "depth").isel(
        latitude=slice(None, None, -1)
    )
    for name in ("uo", "vo"):
        data[name] = (
            data[name].dims,
            100 * data[name].values,
            {**data[name].attrs, "units": "cm/s"},
        )
    return data


def upwards(small):
    """Depths as heights from the deepest on."""
    data = small.isel(depth=slice(None, None, -1))
    return data.assign_coords(depth=("depth", -data.depth.values, {"units": "m", "positive": "up"}))


def unsaid(small):
    """Heights that do not say so, and longitudes from 0 to 360."""
    data = small.assign_coords(depth=("depth", -small.depth.values, {"units": "m", "axis": "Z"}))
    about = small.longitude.attrs
    return data.assign_coords(longitude=("longitude", small.longitude.values + 360.0, about))


@pytest.mark.parametrize("change", [packed, upwards, unsaid])
def test_other_forms_give_the_same_field(small, tmp_path, change):
    want = field_of(small, tmp_path)
    (tmp_path / "other").mkdir()
    found = field_of(change(small), tmp_path / "other")
    np.testing.assert_allclose(found.values, want.values, atol=1e-7)
    np.testing.assert_array_equal(found.wet, want.wet)
    np.testing.assert_allclose(found.knots[2], want.knots[2])


def heights(small):
    """Heights by their standard name alone, of levels on both sides of the mean sea level."""
    about = {"units": "m", "standard_name": "height_above_mean_sea_level"}
    data = small.isel(depth=slice(None, None, -1))
    return data.assign_coords(depth=("depth", 1.0 - data.depth.values, about))


def test_levels_that_are_heights_by_their_standard_name_are_turned(small, tmp_path):
    want = field_of(small, tmp_path)
    (tmp_path / "other").mkdir()
    found = field_of(heights(small), tmp_path / "other")
    np.testing.assert_allclose(found.knots[2], want.knots[2] - 1.0)
    np.testing.assert_allclose(found.values, want.values, atol=1e-7)


MPS = {
    1.0: "m s-1|m/s|m s^-1|m s**-1|m.s-1|ms-1|meter/second|meters/second|metre/second"
    "|meter second-1|meters s-1",
    0.01: "cm s-1|cm/s|cm s^-1|cm.s-1|centimeter/second",
    0.001: "mm s-1|mm/s",
    1000.0 / 3600.0: "km h-1|km/h",
    1852.0 / 3600.0: "knot|knots|kt|kts",
}
"""Spellings of UDUNITS and of common files; the nautical mile of 1852 m (Monaco, 1929)."""
METRES = {1.0: "m|meter|meters|metre|metres", 1000.0: "km"}


def spellings(table):
    return [(unit, factor) for factor, units in table.items() for unit in units.split("|")]


@pytest.mark.parametrize(("unit", "mps"), spellings(MPS))
def test_speeds_in_every_unit_are_metres_a_second(small, tmp_path, unit, mps):
    data = small.isel(time=0, depth=0, drop=True)
    for name in ("uo", "vo"):
        data[name] = data[name].assign_attrs(units=unit) / mps
        data[name].attrs |= {**small[name].attrs, "units": unit}
    field = field_of(data, tmp_path)
    east = small.uo.isel(time=0, depth=0).values
    np.testing.assert_allclose(
        field.values[:, :, 0, 0, 0][field.wet[:, :, 0]], east[field.wet[:, :, 0]], rtol=1e-5
    )


@pytest.mark.parametrize(("unit", "metres"), spellings(METRES))
def test_depths_in_every_unit_are_metres(small, tmp_path, unit, metres):
    about = {**small.depth.attrs, "units": unit}
    data = small.assign_coords(depth=("depth", small.depth.values / metres, about))
    np.testing.assert_allclose(field_of(data, tmp_path).knots[2], small.depth.values)


def test_every_spelling_that_is_read_is_tried():
    assert {unit for unit, _ in spellings(MPS)} == set(cf.PER_SECOND)
    assert {unit for unit, _ in spellings(METRES)} == set(cf.METRES)


def test_classic_netcdf_and_steady_files_of_one_level_are_read(small, tmp_path):
    data = small.isel(time=0, depth=0, drop=True)
    field = ocean.load_field(written(data, tmp_path, engine="scipy"), NONE)
    assert field.shape == (10, 10, 1, 1, 2)
    assert field.begin == ""


def test_upward_velocity_is_taken_where_it_is(small, tmp_path):
    w = small.uo.copy(data=0.01 * small.uo.values)
    w.attrs = {"standard_name": "upward_sea_water_velocity", "units": "m s-1"}
    field = field_of(small.assign(wo=w), tmp_path)
    assert field.shape[4] == 3
    np.testing.assert_allclose(field.values[..., 2], 0.01 * field.values[..., 0], rtol=1e-6)


def without(name):
    return lambda data: data.drop_vars(name)


def missing(data):
    return data.assign(uo=data.uo * np.nan)


def twice(data):
    return data.assign(uo_mean=data.uo)


def unnamed(data):
    data = data.copy(deep=True)
    data.uo.attrs = {"units": "m s-1"}
    return data


def furlongs(data):
    data = data.copy(deep=True)
    data.vo.attrs["units"] = "furlong fortnight-1"
    return data


def backwards(data):
    return data.isel(time=slice(None, None, -1))


def jumbled(data):
    return data.isel(depth=[0, 2, 1])


def dbar(data):
    data = data.copy(deep=True)
    data.depth.attrs["units"] = "dbar"
    return data


def curvilinear(data):
    data = data.rename(latitude="j", longitude="i").drop_vars(["i", "j"])
    shape = ("j", "i"), np.ones((data.sizes["j"], data.sizes["i"]))
    return data.assign_coords(nav_lat=shape, nav_lon=shape)


def members(data):
    return data.expand_dims(member=3)


def timeless(data):
    return data.assign_coords(time=("time", np.arange(data.sizes["time"]), {"units": "fortnights"}))


def noleap(data):
    about = {"units": "days since 2001-01-01", "calendar": "360_day"}
    return data.assign_coords(time=("time", np.arange(float(data.sizes["time"])), about))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (without("vo"), "no variable has the standard_name northward_sea_water_velocity.*v = NAME"),
        (missing, "all are missing"),
        (twice, 'uo, uo_mean all have the standard_name.*u = "uo"'),
        (unnamed, "no variable has the standard_name eastward.*there is uo, vo, deptho"),
        (furlongs, "vo has the units 'furlong fortnight-1'"),
        (backwards, "time must rise"),
        (jumbled, "depth must rise or fall"),
        (dbar, "depth has the units 'dbar'"),
        (curvilinear, r"two-dimensional ones \(nav_lat, nav_lon\): first turn its components"),
        (members, "dimension member of uo has no coordinate"),
        (timeless, "time has the units 'fortnights' .*: times must be as in"),
        (noleap, "time has .* the calendar '360_day': times must be as in"),
    ],
)
def test_files_that_cannot_be_used_are_refused_by_name(small, tmp_path, change, words):
    with pytest.raises(ConfigError, match=words) as told:
        field_of(change(small), tmp_path)
    assert "field.nc" in str(told.value)
    assert "\n" not in str(told.value)


def test_a_name_chooses_among_variables(small, tmp_path):
    field = field_of(twice(small), tmp_path, u="uo_mean")
    assert field.shape[4] == 2
    with pytest.raises(ConfigError, match="u = 'speed': no variable of this file; there is uo, vo"):
        field_of(small, tmp_path, u="speed")


def test_what_is_no_netcdf_is_refused(tmp_path):
    with pytest.raises(ConfigError, match=r"none\.nc: cannot be read .No such file"):
        ocean.load_field(str(tmp_path / "none.nc"), NONE)
    (tmp_path / "text.nc").write_text("velocity\n")
    with pytest.raises(ConfigError, match=r"text\.nc: is no NetCDF file"):
        ocean.load_field(str(tmp_path / "text.nc"), NONE)
    (tmp_path / "cut.nc").write_bytes(b"\x89HDF\r\n\x1a\n" + bytes(100))
    with pytest.raises(ConfigError, match=r"cut\.nc: cannot be read as NetCDF"):
        ocean.load_field(str(tmp_path / "cut.nc"), NONE)


def test_a_field_that_programs_cannot_hold_is_refused_before_it_is_read(
    small, tmp_path, monkeypatch
):
    monkeypatch.setattr(cf, "MAX_BYTES", 9599)
    with pytest.raises(ConfigError, match=r"its field takes 9\.6 kB; 9\.6 kB are the most"):
        field_of(small, tmp_path)


def test_an_edited_file_is_another_field(small, tmp_path):
    before = field_of(small, tmp_path)
    again = field_of(small, tmp_path)
    assert before == again
    assert hash(before) == hash(again)
    after = field_of(small.assign(uo=small.uo * 1.01), tmp_path)
    assert before != after
    assert xarray.open_dataset(tmp_path / "field.nc", engine="h5netcdf").uo.shape == (4, 3, 10, 10)
