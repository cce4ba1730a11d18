"""Files as ROMS, NEMO, HYCOM, Copernicus Marine, GEBCO and NOAA write them: fills, frames, signs.

Masks were compared with those of netCDF4-python 1.7.5 on 595 files of random types and attributes;
the cases of this file are the kinds among them.
"""

import numpy as np
import pytest
import xarray

from angler_experiments.ocean import headland
from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.world import ocean
from angler_mjx.world.currents.gridded import GridConfig
from angler_mjx.world.currents.ground import BathymetryConfig

NONE = {"u": None, "v": None, "w": None}
FILL = 9.969209968386869e36  # NC_FILL_FLOAT of netcdf.h
NORTH = {"standard_name": "latitude", "units": "degrees_north"}
EAST = {"standard_name": "longitude", "units": "degrees_east"}


@pytest.fixture(scope="module")
def small():
    return headland.build_dataset(12).isel(time=slice(0, 3), depth=slice(0, 2))


@pytest.fixture(scope="module")
def field(small, tmp_path_factory):
    return ocean.load_field(written(small, tmp_path_factory.mktemp("plain")), NONE)


def written(data, folder, engine="h5netcdf"):
    path = folder / "field.nc"
    encoding = {name: {"_FillValue": None} for name in data.variables}
    data.to_netcdf(path, engine=engine, encoding=encoding)
    return str(path)


def stored(small, dtype, land, scale=1.0, offset=0.0, **attributes):
    """Velocities as a file stores them: land as one number, packed, with attributes."""
    data = small[["uo", "vo"]].copy()
    for name in data:
        values = (small[name].values - offset) / scale
        values = np.where(np.isnan(values), land, np.rint(values) if scale != 1 else values)
        about = {"standard_name": small[name].standard_name, "units": "m s-1", **attributes}
        if scale != 1.0:
            about |= {"scale_factor": scale, "add_offset": offset}
        data[name] = (small[name].dims, values.astype(dtype), about)
    return data


FLOATS = {
    "default fill": (np.float32, FILL, {}),
    "default fill, double": (np.float64, FILL, {}),
    "valid_min": (np.float32, -9999.0, {"valid_min": np.float32(-10.0)}),
    "valid_range, double": (np.float32, 1e4, {"valid_range": np.array([-5.0, 5.0])}),
    "NEMO": (np.float32, 1e20, {"missing_value": 1e20}),
    "ROMS": (np.float32, 1e37, {"_FillValue": np.float32(1e37)}),
    "several": (np.float32, -99.0, {"missing_value": np.array([1e20, -99.0], np.float32)}),
}
INTEGERS = {
    "default fill": (np.int16, -32767, {}),
    "HYCOM": (np.int16, -30000, dict.fromkeys(("_FillValue", "missing_value"), np.int16(-30000))),
    "Copernicus": (
        np.int16,
        -32767,
        {"_FillValue": np.int16(-32767), "valid_min": np.int16(-9000), "valid_max": np.int16(9000)},
    ),
    "valid_max": (np.int16, 32000, {"valid_max": np.int16(9999)}),
    "double missing_value": (np.int32, -999999, {"missing_value": -999999.0}),
    "valid_range, unpacked and packed": (np.int16, -32767, {"valid_range": np.array([-1e4, 1e4])}),
}


@pytest.mark.parametrize("case", FLOATS)
def test_missing_floats_are_land(small, field, tmp_path, case):
    dtype, land, attributes = FLOATS[case]
    read = ocean.load_field(
        written(stored(small, dtype, land, **attributes), tmp_path, "scipy"), NONE
    )
    np.testing.assert_array_equal(read.wet, field.wet)
    np.testing.assert_array_equal(read.values, field.values)


@pytest.mark.parametrize("case", INTEGERS)
def test_missing_packed_integers_are_land(small, field, tmp_path, case):
    dtype, land, attributes = INTEGERS[case]
    data = stored(small, dtype, land, 1e-4, 0.01, **attributes)
    read = ocean.load_field(written(data, tmp_path), NONE)
    np.testing.assert_array_equal(read.wet, field.wet)
    np.testing.assert_allclose(read.values, field.values, atol=0.51e-4)


def test_unsigned_bytes_are_read_as_such(small, field, tmp_path):
    # Classic NetCDF has no unsigned bytes: 255 is stored as -1.
    data = stored(small, np.uint8, 255, 0.005, -0.6, _FillValue=np.int8(-1), _Unsigned="true")
    data = data.map(lambda v: v.copy(data=v.values.view(np.int8)), keep_attrs=True)
    read = ocean.load_field(written(data, tmp_path, "scipy"), NONE)
    np.testing.assert_array_equal(read.wet, field.wet)
    np.testing.assert_allclose(read.values, field.values, atol=0.0026)


@pytest.mark.parametrize(
    ("attributes", "words"),
    [
        ({"valid_max": 0.5}, r"uo: valid_max = 0.5 is float64 and its values are int16: give it"),
        ({"valid_range": np.int16(3)}, "uo: valid_range = 3: must be 2 numbers"),
        ({"missing_value": "none"}, "uo: missing_value = 'none': must be numbers"),
    ],
)
def test_attributes_that_readers_take_otherwise_are_refused(small, tmp_path, attributes, words):
    data = stored(small, np.int16, -32767, 1e-4, 0.01, **attributes)
    with pytest.raises(ConfigError, match=words):
        ocean.load_field(written(data, tmp_path), NONE)


def test_speeds_that_no_sea_has_are_refused_with_their_place(small, tmp_path):
    data = small.copy(deep=True)
    data.vo.values[1, 0, 6, 2] = -31.5
    spot = rf"vo = -31\.5 m/s at 2024-06-01T01:00:00, latitude {data.latitude[6]:g}, "
    with pytest.raises(ConfigError, match=spot + rf"longitude {data.longitude[2]:g}, depth 0.5 m"):
        ocean.load_field(written(data, tmp_path), NONE)
    data.vo.values[1, 0, 6, 2] = np.inf
    with pytest.raises(ConfigError, match="vo = inf m/s"):
        ocean.load_field(written(data, tmp_path), NONE)
    data.vo.values[1, 0, 6, 2], data.uo.values[1, 0, 6, 2] = 19.9, 0.0
    assert ocean.load_field(written(data, tmp_path), NONE).values.max() == np.float32(19.9)
    path = written(small, tmp_path)
    fastest = np.sqrt(np.nanmax(small.uo.values**2 + small.vo.values**2))
    for speed, is_refused in ((19.9 / fastest, False), (20.1 / fastest, True)):
        table = {"file": path, "scale": {"space": 10.0, "speed": float(speed)}}
        if is_refused:
            with pytest.raises(ConfigError, match=r"scale: makes 20\.1 m/s"):
                parse_model(GridConfig, table, source="test")
        else:
            parse_model(GridConfig, table, source="test")


def on_rotated_pole(data, **more):
    """As COSMO and AMM15 write it: regular about a pole that is not the Earth's."""
    about = {"grid_mapping_name": "rotated_latitude_longitude", "grid_north_pole_latitude": 39.25}
    data = data.rename(latitude="rlat", longitude="rlon").assign(rotated_pole=((), 0, about))
    for name, component in (("uo", "x"), ("vo", "y")):
        data[name].attrs |= {"standard_name": f"sea_water_{component}_velocity"}
        data[name].attrs |= {"grid_mapping": "rotated_pole"}
    return data.assign_coords(
        rlat=("rlat", data.rlat.values, {"units": "degrees", "axis": "Y", **more.get("y", {})}),
        rlon=("rlon", data.rlon.values, {"units": "degrees", "axis": "X", **more.get("x", {})}),
    )


def on_plane(data, mapping, *, names=True, unit="m", **attributes):
    """On axes in metres of a map projection."""
    data = data.rename(latitude="y", longitude="x")
    for i, name in enumerate(("uo", "vo")):
        data[name].attrs |= {"standard_name": f"sea_water_{'xy'[i]}_velocity", **attributes}
        if mapping:
            data[name].attrs["grid_mapping"] = "crs"
    if mapping:
        data["crs"] = ((), 0, {"grid_mapping_name": mapping})
    axes = {}
    for name in ("x", "y"):
        about = {"standard_name": f"projection_{name}_coordinate"} if names else {}
        axes[name] = (name, 500.0 * np.arange(data.sizes[name]), {"units": unit, **about})
    return data.assign_coords(axes)


def eastward_on_plane(data):
    data = on_plane(data, "transverse_mercator")
    data.uo.attrs["standard_name"] = "eastward_sea_water_velocity"
    return data


def with_flat_places(data):
    data = on_plane(data, None)
    shape = np.ones((data.sizes["y"], data.sizes["x"]))
    return data.assign_coords(lat=(("y", "x"), shape, NORTH), lon=(("y", "x"), shape, EAST))


def staggered(data):
    """As ROMS writes it: each component on points of its own, their places in two dimensions."""
    out = xarray.Dataset()
    for name, point in (("uo", "u"), ("vo", "v")):
        dims = {"latitude": f"eta_{point}", "longitude": f"xi_{point}"}
        part = data[name].rename(dims).drop_vars(list(dims.values()))
        part.attrs["standard_name"] = f"sea_water_{'x' if point == 'u' else 'y'}_velocity"
        shape = (tuple(dims.values()), np.ones((12, 12)))
        out[name] = part.assign_coords({f"lat_{point}": shape, f"lon_{point}": shape})
    return out


def polewise(data):
    return on_rotated_pole(
        data, y={"standard_name": "grid_latitude"}, x={"standard_name": "grid_longitude"}
    )


def as_if_true(data):
    return on_rotated_pole(data, y=NORTH, x=EAST)


def crossed(data):
    about = {**NORTH, "units": "degrees_east"}
    return data.assign_coords(latitude=("latitude", data.latitude.values, about))


def beyond_the_pole(data):
    return data.assign_coords(latitude=("latitude", data.latitude.values + 50, NORTH))


def above_the_floor(data):
    about = {"standard_name": "height_above_sea_floor", "units": "m", "axis": "Z"}
    return data.assign_coords(depth=("depth", data.depth.values, about))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (polewise, "rlat is a grid_latitude, no latitude or longitude: first turn .* cdo rotuvb"),
        (on_rotated_pole, "rlat has the units 'degrees': true latitudes have degrees_north"),
        (as_if_true, "uo stands on the grid mapping rotated_latitude_longitude: first turn"),
        (
            lambda data: on_plane(data, "polar_stereographic", unit="km"),
            "uo stands on the grid mapping polar_stereographic: first turn",
        ),
        (eastward_on_plane, "uo is eastward_sea_water_velocity, and y and x are those of a map"),
        (with_flat_places, "y and x are in metres of a map projection that it does not describe"),
        (staggered, r"dimension eta_u of uo has .*two-dimensional ones \(lat_u, lon_u\): first"),
        (crossed, "latitude has the units 'degrees_east'"),
        (beyond_the_pole, r"latitude goes from 100\.4.* degrees; correct it"),
        (above_the_floor, "dimension depth of uo is none of latitude, longitude, depth"),
    ],
)
def test_axes_and_components_of_other_frames_are_refused(small, tmp_path, change, words):
    data = change(small[["uo", "vo"]].copy(deep=True))
    with pytest.raises(ConfigError, match=words) as caught:
        ocean.load_field(written(data, tmp_path), NONE)
    assert "\n" not in str(caught.value)


def test_a_projection_that_is_not_described_is_refused(small, tmp_path):
    data = on_plane(small[["uo", "vo"]].copy(deep=True), "transverse_mercator").drop_vars("crs")
    with pytest.raises(ConfigError, match="uo has the grid mapping 'crs', which the file does not"):
        ocean.load_field(written(data, tmp_path), NONE)


@pytest.mark.parametrize("mapping", ["transverse_mercator", None])
def test_components_along_axes_of_a_plane_are_taken_as_they_are(small, field, tmp_path, mapping):
    data = on_plane(small[["uo", "vo"]].copy(deep=True), mapping, unit="km")
    read = ocean.load_field(written(data, tmp_path), NONE)
    assert not read.degrees
    np.testing.assert_array_equal(read.knots[0], 5e5 * np.arange(12))
    np.testing.assert_array_equal(read.values[read.wet], field.values[field.wet])


def test_a_geographic_grid_mapping_is_no_hindrance(small, field, tmp_path):
    data = small[["uo", "vo"]].copy(deep=True)
    data["crs"] = ((), 0, {"grid_mapping_name": "latitude_longitude"})
    data.uo.attrs["grid_mapping"] = "crs: latitude longitude"
    data.vo.attrs["grid_mapping"] = "lost"  # cut off by ncks: the axes say what they are
    assert ocean.load_field(written(data, tmp_path), NONE) == field


@pytest.mark.parametrize(
    ("names", "words"),
    [
        ({"u": "vo"}, "u = 'vo': has the standard_name northward_sea_water_velocity, must be as"),
        ({"v": "uo"}, "v = 'uo': has the standard_name eastward_sea_water_velocity, must be as in"),
        ({"w": "uo"}, "w = 'uo': has .*, must be as in upward_sea_water_velocity"),
    ],
)
def test_components_that_are_named_as_others_are_refused(small, tmp_path, names, words):
    with pytest.raises(ConfigError, match=words):
        ocean.load_field(written(small, tmp_path), {**NONE, **names})


def test_components_of_other_products_are_taken_by_name(small, field, tmp_path):
    data = small[["uo", "vo"]].copy(deep=True)
    data.uo.attrs["standard_name"] = "surface_geostrophic_eastward_sea_water_velocity"
    data.vo.attrs.pop("standard_name")
    read = ocean.load_field(written(data, tmp_path), {"u": "uo", "v": "vo", "w": None})
    np.testing.assert_array_equal(read.values, field.values)


def in_days(data, units, days, calendar):
    hours = np.arange(data.sizes["time"]) / 24.0
    return data.assign_coords(time=("time", days + hours, {"units": units, "calendar": calendar}))


@pytest.mark.parametrize(
    ("calendar", "days"),
    [
        # The Julian day of 2024-06-01 is 2460462.5, those of the years' first days 1721425.5
        # (Gregorian) and 1721423.5 (Julian, of which the standard calendar is before 1582).
        ("proleptic_gregorian", 2460462.5 - 1721425.5),
        ("standard", 2460462.5 - 1721423.5),
        ("gregorian", 2460462.5 - 1721423.5),
    ],
)
def test_days_since_year_one_are_read(small, field, tmp_path, calendar, days):
    data = in_days(small, "days since 0001-01-01 00:00:00", days, calendar)
    read = ocean.load_field(written(data, tmp_path), NONE)
    assert read.begin == field.begin
    np.testing.assert_allclose(read.knots[3], field.knots[3], atol=1e-3)


@pytest.mark.parametrize(
    ("units", "calendar", "words"),
    [
        (
            "days since 0000-01-01",
            "standard",
            r"cannot be read \(zero not allowed as a reference year .*\): times must be",
        ),
        (
            "days since 2024-13-01",
            "standard",
            r"cannot be read \(invalid month .*\): times must be",
        ),
        ("days since 0001-01-01", "noleap", "and the calendar 'noleap': times must be"),
        (
            "months since 2024-01-01",
            "standard",
            r"cannot be read \('months since' units only .*\): times must be",
        ),
    ],
)
def test_times_that_cannot_be_read_are_refused_in_whole_sentences(
    small, tmp_path, units, calendar, words
):
    with pytest.raises(ConfigError, match=f"time has the units .*{words}"):
        ocean.load_field(written(in_days(small, units, 700000.5, calendar), tmp_path), NONE)


def test_times_that_were_never_written_are_refused(small, tmp_path):
    about = {"units": "hours since 2024-06-01", "standard_name": "time"}
    data = small.assign_coords(time=("time", [0.0, 1.0, FILL], about))
    with pytest.raises(ConfigError, match="time has missing times; cut them off"):
        ocean.load_field(written(data, tmp_path), NONE)


def floor(small, name, values, axes=("latitude", "longitude"), **attributes):
    """A file of a sea floor, and nothing else."""
    coords = dict(zip(axes, (small.latitude.values, small.longitude.values), strict=True))
    about = ({**NORTH, "long_name": "latitude"}, {**EAST, "long_name": "longitude"})
    if axes == ("y", "x"):  # of GMT
        about = tuple({"units": "degrees", "long_name": one["long_name"]} for one in about)
    data = xarray.Dataset({name: (axes, values, {"units": "m", **attributes})})
    return data.assign_coords(
        {axis: (axis, coords[axis], one) for axis, one in zip(axes, about, strict=True)}
    )


@pytest.fixture(scope="module")
def height(small):
    """Heights of both signs, m: a slope with a shore."""
    slope = np.add.outer(-4 * np.arange(12), np.arange(12)) + 9
    return slope.astype(np.int16)


GEBCO = {"standard_name": "height_above_mean_sea_level"}
FLOORS = {
    "GEBCO": ("elevation", -1, GEBCO, {}),
    "GEBCO 2014": ("elevation", -1, {"standard_name": "height_above_reference_ellipsoid"}, {}),
    "ETOPO 2022": ("z", -1, {"standard_name": "height", "positive": "up"}, {}),
    "ETOPO 1": ("z", -1, {}, {"variable": "z", "positive": "up"}),
    "positive alone": ("z", -1, {"positive": "up"}, {"variable": "z"}),
    "elevation unmarked": ("elevation", -1, {}, {"variable": "elevation"}),
    "surface_altitude": ("topo", -1, {"standard_name": "surface_altitude"}, {"positive": "up"}),
    "contradictory, up": (
        "z",
        -1,
        {"standard_name": "sea_floor_depth", "positive": "up"},
        {"positive": "up"},
    ),
    "Copernicus": ("deptho", 1, {"standard_name": "sea_floor_depth_below_geoid"}, {}),
    "NEMO": ("Bathymetry", 1, {"positive": "down"}, {"variable": "Bathymetry"}),
    "contradictory, down": ("z", 1, {**GEBCO, "positive": "down"}, {"positive": "down"}),
    "both signs, down": ("h", 1, {}, {"variable": "h", "positive": "down"}),
    "deptho unmarked": ("deptho", 1, {}, {"variable": "deptho"}),
}


@pytest.mark.parametrize("case", FLOORS)
def test_sea_floors_lie_where_the_file_says(small, height, tmp_path, case):
    name, sign, attributes, keys = FLOORS[case]
    axes = ("y", "x") if case == "ETOPO 1" else ("latitude", "longitude")
    values = height if sign < 0 else -height
    table = {"file": written(floor(small, name, values, axes, **attributes), tmp_path), **keys}
    read = parse_model(BathymetryConfig, table, source="test").floor
    np.testing.assert_array_equal(read.wet, height < 0)
    np.testing.assert_array_equal(read.depth_m[read.wet], -height[height < 0])


@pytest.mark.parametrize("sign", [-1, 1])
def test_a_floor_of_one_sign_needs_no_direction(small, height, tmp_path, sign):
    values = sign * np.where(height < 0, -height, 0)
    table = {"file": written(floor(small, "h", values), tmp_path), "variable": "h"}
    read = parse_model(BathymetryConfig, table, source="test").floor
    np.testing.assert_array_equal(read.wet, height < 0)
    np.testing.assert_array_equal(read.depth_m[read.wet], -height[height < 0])


@pytest.mark.parametrize(
    ("attributes", "keys", "words"),
    [
        ({}, {}, 'z has values of both signs and does not say .*positive = "down" of depths'),
        (
            {"standard_name": "sea_floor_depth", "positive": "up"},
            {},
            "z has the standard_name sea_floor_depth and positive = up, which contradict",
        ),
        (GEBCO, {"positive": "down"}, 'z is positive up by .* leave out positive = "down"'),
        ({"positive": "down"}, {"positive": "up"}, 'z is positive down by .* out positive = "up"'),
        ({}, {"positive": "sideways"}, "positive = 'sideways': .*'up' or 'down'"),
        ({"scale_factor": -1e4, "positive": "down"}, {}, r"z is \d+ m at y 50\.\d+, x -2\.\d+: no"),
        ({"add_offset": 500.0, "positive": "up"}, {}, r"sea floor \(z\) lies nowhere below"),
        ({"units": "1", "positive": "up"}, {}, "z has the units '1': must be m or km"),
    ],
)
def test_sea_floors_that_do_not_say_what_they_are_are_refused(
    small, height, tmp_path, attributes, keys, words
):
    path = written(floor(small, "z", height, **attributes), tmp_path)
    with pytest.raises(ConfigError, match=words):
        parse_model(BathymetryConfig, {"file": path, "variable": "z", **keys}, source="test")


def test_missing_depths_of_a_sea_floor_are_land(small, height, tmp_path):
    values = np.where(height < 0, -height, 0).astype(np.float32)
    values[7, 7] = FILL
    data = floor(small, "deptho", values, standard_name="sea_floor_depth_below_geoid")
    read = parse_model(BathymetryConfig, {"file": written(data, tmp_path)}, source="test").floor
    assert height[7, 7] < 0
    assert not read.wet[7, 7]
    assert read.depth_m.max() < 60


def test_a_sea_floor_on_a_rotated_pole_is_refused(small, height, tmp_path):
    data = floor(small, "elevation", height, **GEBCO)
    data = data.rename(latitude="rlat", longitude="rlon")
    for name in ("latitude", "longitude"):
        data[f"r{name[:3]}"].attrs = {"standard_name": f"grid_{name}", "units": "degrees"}
    with pytest.raises(ConfigError, match="rlat is a grid_latitude"):
        parse_model(BathymetryConfig, {"file": written(data, tmp_path)}, source="test")
