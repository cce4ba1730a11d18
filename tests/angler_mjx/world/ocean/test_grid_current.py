"""Currents of a file: where worlds lie in it, what flows there, and what tables are refused."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import xarray
from pydantic import Field

from angler_mjx.errors import ConfigError
from angler_mjx.files import FOLDER_CONTEXT, FileModel, parse_model
from angler_mjx.world import currents

from ...compiling import quickly

LO, HI = jnp.array([-30.0, -20.0, -14.0]), jnp.array([20.0, 20.0, -2.0])
CENTRE = np.array([-5.0, 0.0])
A, F = 6378137.0, 1 / 298.257223563


class File(FileModel):
    current: tuple[currents.CurrentConfig, ...] = Field(default=())


def configs(ocean_file, **keys):
    data = {"current": [{"type": "grid", "file": ocean_file.name, **keys}]}
    return parse_model(
        File, data, source="test", context={FOLDER_CONTEXT: ocean_file.parent}
    ).current


def drawn(config, n, horizon_s=120.0):
    def one(key):
        return currents.sample_current(currents.build_samplers(config, horizon_s), key, LO, HI)[0]

    return quickly(jax.vmap(one))(jax.random.split(jax.random.key(4), n))


def where(current):
    """Latitude and longitude of each world's origin, and its start in s, from the file's knots."""
    knots = [np.asarray(one) for one in current.field.knots]
    rest, knot = np.asarray(current.rest, float), np.asarray(current.knot)
    y, x, _, t = (knots[i][knot[:, i]] + rest[:, i] for i in range(4))
    return y, x, t


def degrees(latitude):
    """Of latitude and of longitude to a metre north and east, by differences on the ellipsoid."""
    e2 = F * (2 - F)
    at = np.radians(latitude)
    n = A / np.sqrt(1 - e2 * np.sin(at) ** 2)
    step = 1e-4

    def place(angle):
        r = A / np.sqrt(1 - e2 * np.sin(angle) ** 2)
        return np.stack([r * np.cos(angle), r * (1 - e2) * np.sin(angle)])

    north = np.linalg.norm(place(at + step) - place(at - step), axis=0) / (2 * step)
    return np.degrees(1 / north), np.degrees(1 / (n * np.cos(at)))


@pytest.fixture(scope="module")
def current(ocean_file):
    return drawn(configs(ocean_file), 400)


def test_flow_is_that_of_xarray_at_the_place_in_the_file(ocean_file, current):
    rng = np.random.default_rng(1)
    n, many = 400, 5
    p = np.stack(
        [rng.uniform(a, b, (n, many)) for a, b in zip(LO.tolist(), HI.tolist(), strict=True)],
        axis=2,
    )
    p[..., 2] *= 2.5  # down to 35 m
    t = rng.uniform(0, 120, (n, many))
    flow = quickly(jax.vmap(jax.vmap(lambda c, p, t: c.flow(p, t), (None, 0, 0))))
    v = np.asarray(flow(current, p.astype(np.float32), t.astype(np.float32))[0])
    field = current.field
    axes = dict(zip(("y", "x", "depth", "time"), field.knots, strict=True))
    whole = xarray.DataArray(field.values.astype(float), dims=[*axes, "part"], coords=axes)
    y, x, begin = where(current)
    middle = y + CENTRE[1] * degrees(y)[0]
    north, east = degrees(middle)
    points = {
        "y": y[:, None] + north[:, None] * p[..., 1],
        "x": x[:, None] + east[:, None] * p[..., 0],
        "depth": -p[..., 2],
        "time": begin[:, None] + t,
    }
    at = {  # held beyond the edges of the file
        key: xarray.DataArray(np.clip(value, axes[key][0], axes[key][-1]), dims=("world", "point"))
        for key, value in points.items()
    }
    want = whole.interp(at).values
    assert np.abs(want).max() > 0.2
    np.testing.assert_allclose(v[..., :2], want, atol=1e-6)
    assert np.all(v[..., 2] == 0)


def test_worlds_lie_in_water_all_over_the_file(current):
    y, x, t = where(current)
    field, config_depth = current.field, 8.0
    north, east = degrees(y)
    y, x = y + CENTRE[1] * north, x + CENTRE[0] * east  # the middle of the region
    i, j = (np.searchsorted(knots, at) - 1 for knots, at in zip(field.knots, (y, x), strict=False))
    level = np.searchsorted(field.knots[2], config_depth, side="right") - 1
    corners = [field.wet[i + a, j + b, : level + 1] for a in (0, 1) for b in (0, 1)]
    assert np.all(corners)
    lowest = min(len(np.unique(i)), len(np.unique(j)))
    assert lowest > 15, "of 23 rows and columns, few without water"
    assert t.min() >= 0
    assert t.max() <= field.knots[3][-1] - 120
    # Uniform: mean and deviation of 400 starts within four standard errors.
    span = field.knots[3][-1] - 120
    assert abs(t.mean() / span - 0.5) < 4 / np.sqrt(12 * 400)
    # An hour is a knot: what lies beyond it is said in few digits.
    assert np.all(np.asarray(current.rest)[:, 3] <= 3600.0)


def test_a_place_and_a_time_that_are_given_are_taken(ocean_file):
    config = configs(
        ocean_file,
        latitude=[50.53, 50.53],
        longitude=[357.57, 357.57],
        time=["2024-06-01T06:10", "2024-06-01T06:10"],
    )
    y, x, t = where(drawn(config, 7))
    north, east = degrees(50.53)
    np.testing.assert_allclose(y, 50.53 - CENTRE[1] * north, atol=1e-7)
    np.testing.assert_allclose(x, -2.43 - CENTRE[0] * east, atol=1e-7)
    np.testing.assert_allclose(t, 6 * 3600 + 600, atol=1e-3)


def test_scale_shrinks_slows_and_keeps_the_pattern(ocean_file):
    place = {"latitude": [50.54, 50.54], "longitude": [-2.43, -2.43]}
    place["time"] = ["2024-06-01T05:00", "2024-06-01T05:00"]
    whole, small = (
        currents.sample_current(
            currents.build_samplers(configs(ocean_file, **place, **keys), 10.0),
            jax.random.key(0),
            -HI,
            HI,
        )[0]
        for keys in ({}, {"scale": {"space": 0.01, "depth": 0.01, "speed": 0.1}})
    )
    p, t = jnp.array([120.0, -200.0, -9.0]), jnp.array(900.0)
    v, v_t, J = whole.flow(p, t)
    w, w_t, K = small.flow(0.01 * p, 0.1 * t)  # a tenth of the time: 0.01 / 0.1
    np.testing.assert_allclose(w, 0.1 * v, atol=1e-6)
    np.testing.assert_allclose(w_t, v_t, rtol=1e-4, atol=1e-9)
    np.testing.assert_allclose(K, 10 * J, rtol=1e-4, atol=1e-8)
    fast = currents.scale_current((small,), jnp.array(3.0))
    np.testing.assert_allclose(currents.velocity(fast, 0.01 * p, 0.1 * t), 0.3 * v, atol=1e-6)


def test_derivatives_equal_automatic_differentiation(current):
    def both(c, p, t):
        slopes = jax.jacfwd(lambda *at: c.flow(*at)[0], argnums=(0, 1))(p, t)
        return c.flow(p, t)[1:], slopes

    p = jnp.array([3.0, -7.0, -8.0])
    (v_t, J), (K, w_t) = quickly(jax.vmap(both, (0, None, None)))(current, p, jnp.array(40.0))
    np.testing.assert_allclose(J, K, atol=1e-9)
    np.testing.assert_allclose(v_t, w_t, atol=1e-10)
    assert np.abs(J[:, 0, 2]).max() > 1e-4


def test_a_world_is_the_same_in_any_company(ocean_file, current):
    alone = drawn(configs(ocean_file), 3)
    np.testing.assert_array_equal(np.asarray(alone.rest), np.asarray(current.rest)[:3])
    beside = parse_model(
        File,
        {
            "current": [
                {"type": "vortices", "count": 2, "peak_speed_mps": [0.1, 0.2]},
                {"type": "grid", "file": str(ocean_file)},
            ]
        },
        source="test",
    ).current
    key = jax.random.key(9)
    first = currents.sample_current(currents.build_samplers(beside[:1], 60.0), key, LO, HI)[0]
    both = currents.sample_current(currents.build_samplers(beside, 60.0), key, LO, HI)
    np.testing.assert_array_equal(first.centre_m, both[0].centre_m)


@pytest.mark.parametrize(
    ("keys", "words"),
    [
        ({"file": "other.nc"}, r"other\.nc: cannot be read"),
        ({"latitude": [10.0, 11.0]}, r"latitude = \[10.0, 11.0\].* within the file's 50.4865"),
        ({"longitude": [-2.4, -2.5]}, "low <= high"),
        ({"longitude": [120.0, 120.0]}, "longitude"),
        ({"latitude": [50.49, 50.49], "longitude": [-2.45, -2.45]}, "there is no water"),
        ({"time": ["2023-01-01", "2023-01-02"]}, "within the file's 2024-06-01T00:00:00 to"),
        ({"time": ["noon", "2023-01-02"]}, "two times as in"),
        ({"u": "speed"}, "u = 'speed': no variable"),
        ({"scale": {"space": 0}}, "space"),
        ({"scale": {"width": 2}}, "width"),
    ],
)
def test_bad_tables_are_refused(ocean_file, keys, words):
    with pytest.raises(ConfigError, match=words):
        configs(ocean_file, **keys)


def test_a_run_that_the_times_do_not_cover_is_refused(ocean_file):
    (config,) = configs(ocean_file, scale={"space": 0.001, "speed": 0.1})
    with pytest.raises(ValueError, match=r"covers 2024-06-01.*a run of 1200 s"):
        config.starts_s(1200.0)
