"""Currents as a list of components, and their drawing from a config."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from pydantic import Field

from angler_mjx.errors import ConfigError
from angler_mjx.files import FileModel, parse_model
from angler_mjx.world import currents

from ..compiling import quickly

LO, HI = jnp.array([-12.0, -12.0, -26.0]), jnp.array([12.0, 12.0, -2.0])


class File(FileModel):
    current: tuple[currents.CurrentConfig, ...] = Field(default=())


def configs(*entries):
    return parse_model(File, {"current": list(entries)}, source="test").current


def test_derivative_is_taken_of_the_sum():
    with jax.enable_x64(True):
        vortex = currents.Vortices(
            centre_m=jnp.array([[0.5, -1.0], [2.0, 2.0]]),
            circulation_m2ps=jnp.array([1.5, -2.0]),
            core_m=jnp.array([1.0, 2.0]),
        )
        wind = currents.GaussMarkov(
            knots_mps=jnp.array([[0.1, 0.2, 0.0], [0.3, -0.1, 0.05], [0.0, 0.0, 0.0]]),
            knot_dt_s=jnp.array(5.0),
        )
        steady = currents.Uniform(velocity_mps=jnp.array([0.2, -0.1, 0.03]))
        current = (steady, wind, vortex)
        p, t = jnp.array([1.0, 1.0, -4.0]), jnp.array(3.3)
        v, Dv = currents.evaluate_current(current, p, t)
        parts = [currents.velocity((part,), p, t) for part in current]
        np.testing.assert_allclose(v, sum(parts), atol=1e-16)
        # (v . grad) v + dv/dt by forward differentiation of the velocity alone.
        _, want = jax.jvp(
            lambda p, t: currents.velocity(current, p, t), (p, t), (v, jnp.ones_like(t))
        )
        np.testing.assert_allclose(Dv, want, atol=1e-15)
        alone = sum(currents.evaluate_current((part,), p, t)[1] for part in current)
        assert np.linalg.norm(Dv - alone) > 1e-3, "the derivative of a sum is not the sum"


def test_no_component_is_still_water():
    v, Dv = currents.evaluate_current((), jnp.ones(3), jnp.array(1.0))
    assert np.all(v == 0)
    assert np.all(Dv == 0)


def drawn_knots(entry, n_world, horizon_s):
    config = configs(entry)

    def one(key):
        return currents.sample_current(currents.build_samplers(config, horizon_s), key, LO, HI)[
            0
        ].knots_mps

    return np.asarray(quickly(jax.vmap(one))(jax.random.split(jax.random.key(1), n_world)))


def test_gauss_markov_has_its_stationary_statistics():
    std, tau, dt, n = 0.05, 30.0, 5.0, 4000
    mean = np.array([0.1, -0.05, 0.0])
    knots = drawn_knots(
        {
            "type": "gauss_markov",
            "max_speed_mps": 0.5,  # seven deviations away: nothing is clipped
            "std_mps": std,
            "mean_mps": mean.tolist(),
            "time_constant_s": tau,
            "knot_dt_s": dt,
            "vertical_fraction": 0.2,
        },
        n,
        60.0,
    )
    assert knots.shape == (n, 13, 3)
    want = std * np.array([1.0, 1.0, 0.2])
    # Four standard errors of a mean, a deviation and a correlation over n independent worlds.
    for k in (0, 6, 12):
        assert np.all(np.abs(knots[:, k].mean(axis=0) - mean) < 4 * want / np.sqrt(n))
        np.testing.assert_allclose(knots[:, k].std(axis=0), want, rtol=4 / np.sqrt(2 * n))
    x = (knots - mean) / want
    for lag in (1, 3, 12):
        rho = np.exp(-lag * dt / tau)
        correlation = (x[:, 0] * x[:, lag]).mean(axis=0)
        error = np.sqrt((1 + rho * rho) / n)
        assert np.all(np.abs(correlation - rho) < 4 * error)
    assert np.all(np.abs((x[:, 0, 0] * x[:, 0, 1]).mean()) < 4 / np.sqrt(n))


def test_maximum_speed_is_never_exceeded():
    entry = {"type": "gauss_markov", "max_speed_mps": 0.3}
    config = configs(entry)

    def one(key):
        current = currents.sample_current(currents.build_samplers(config, 120.0), key, LO, HI)
        at = jax.vmap(lambda t: currents.velocity(current, jnp.zeros(3), t))
        return at(jnp.linspace(0.0, 130.0, 301))

    v = np.asarray(quickly(jax.vmap(one))(jax.random.split(jax.random.key(2), 500)))
    speed = np.linalg.norm(v, axis=-1)
    assert speed.max() <= 0.3 * (1 + 5e-7)  # rounding of float32
    knots = np.linalg.norm(drawn_knots(entry, 500, 120.0), axis=-1)
    # Two horizontal axes of 0.12 m/s: P(speed > 0.3) = exp(-2.5^2 / 2) = 0.044, the vertical axis
    # adds little; about 3,000 independent knots.
    assert np.mean(knots > 0.2999) == pytest.approx(0.044, abs=0.015)


def test_vortices_are_drawn_inside_their_spans():
    config = configs(
        {
            "type": "vortices",
            "count": 3,
            "peak_speed_mps": [0.2, 0.4],
            "core_radius_m": [1.0, 2.5],
        }
    )

    def one(key):
        return currents.sample_current(currents.build_samplers(config, 120.0), key, LO, HI)[0]

    drawn = quickly(jax.vmap(one))(jax.random.split(jax.random.key(3), 400))
    core, gamma = np.asarray(drawn.core_m), np.asarray(drawn.circulation_m2ps)
    assert core.min() >= 1.0
    assert core.max() <= 2.5
    assert np.all((drawn.centre_m >= LO[:2]) & (drawn.centre_m <= HI[:2]))
    # 1,200 fair signs: four standard errors.
    assert np.mean(gamma > 0) == pytest.approx(0.5, abs=4 * 0.5 / np.sqrt(1200))
    single = replace(drawn, **{k: v[:, :1] for k, v in vars(drawn).items()})
    radius = np.linspace(0.2, 4.0, 400)

    def profile(vortex, r):
        p = jnp.concatenate([vortex.centre_m[0] + jnp.stack([r, 0 * r]), jnp.zeros(1)])
        return jnp.linalg.norm(currents.velocity((vortex,), p, jnp.zeros(())))

    speed = quickly(jax.vmap(jax.vmap(profile, (None, 0)), (0, None)))(single, jnp.asarray(radius))
    peak = np.asarray(speed).max(axis=1)
    # The grid of radii misses the flat peak by a hundredth of a core at most.
    assert peak.min() >= 0.2 * 0.999
    assert peak.max() <= 0.4 * 1.001
    assert peak.max() - peak.min() > 0.15


def test_rankine_vortices_stand_where_they_are_told_and_turn_as_told():
    config = configs(
        {
            "type": "rankine",
            "centre_m": [[1.0, 2.0], [-3.0, 4.0]],
            "turning": "clockwise",
            "peak_speed_mps": [0.3, 0.3],
            "core_radius_m": [2.0, 2.0],
        }
    )
    (vortex,) = currents.sample_current(
        currents.build_samplers(config, 120.0), jax.random.key(0), LO, HI
    )
    np.testing.assert_array_equal(vortex.centre_m, [[1.0, 2.0], [-3.0, 4.0]])
    alone = replace(vortex, **{k: v[:1] for k, v in vars(vortex).items()})
    v = currents.velocity((alone,), jnp.array([3.0, 2.0, -5.0]), jnp.zeros(()))
    np.testing.assert_allclose(v, [0.0, -0.3, 0.0], atol=1e-6)


def test_gyre_fills_the_region():
    config = configs({"type": "double_gyre", "peak_speed_mps": 0.2})
    (gyre,) = currents.sample_current(
        currents.build_samplers(config, 120.0), jax.random.key(0), LO, HI
    )
    corner = jnp.array([-12.0, -12.0, -5.0])
    middle = jnp.array([0.0, 0.0, -5.0])
    still = currents.velocity((gyre,), corner, jnp.zeros(()))
    np.testing.assert_allclose(still, 0.0, atol=1e-7)
    # The region is as wide as long, so the water is fastest between the gyres.
    v = currents.velocity((gyre,), middle, jnp.zeros(()))
    np.testing.assert_allclose(v, [0.0, -0.2, 0.0], atol=1e-7)


def test_drawing_depends_only_on_the_key():
    config = configs(
        {"type": "vortices", "count": 2, "peak_speed_mps": [0.2, 0.4]},
        {"type": "uniform", "velocity_mps": [0.1, 0.0, 0.0]},
    )
    key = jax.random.key(4)
    a, b, c = (
        currents.sample_current(currents.build_samplers(config, 10.0), k, LO, HI)
        for k in (key, key, jax.random.key(5))
    )
    assert np.array_equal(a[0].centre_m, b[0].centre_m)
    assert not np.array_equal(a[0].centre_m, c[0].centre_m)
    np.testing.assert_allclose(a[1].velocity_mps, [0.1, 0.0, 0.0], rtol=1e-7)


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"type": "vortices", "count": 2, "peak_speed_mps": [0.4, 0.2]}, "low <= high"),
        (
            {
                "type": "vortices",
                "count": 2,
                "peak_speed_mps": [0.1, 0.2],
                "core_radius_m": [0.5, 2],
            },
            "1 <= low",
        ),
        ({"type": "rankine", "peak_speed_mps": [0.1, 0.2]}, "count is missing"),
        ({"type": "rankine", "count": 1, "peak_speed_mps": [0.3, 0.2]}, "peak_speed_mps = .0.3"),
        (
            {
                "type": "rankine",
                "count": 2,
                "centre_m": [[0.0, 1.0]],
                "peak_speed_mps": [0.1, 0.2],
            },
            "count = 2, but centre_m has 1",
        ),
        ({"type": "double_gyre", "peak_speed_mps": 0.2, "epsilon": 0.5}, "epsilon"),
        ({"type": "double_gyre", "peak_speed_mps": 0.0}, "peak_speed_mps"),
        ({"type": "double_gyre", "peak_speed_mps": 0.2, "period_s": 0}, "period_s"),
        ({"type": "gauss_markov", "max_speed_mps": -1}, "max_speed_mps"),
        ({"type": "gauss_markov", "max_speed_mps": 0.1, "mean_mps": [1, 0, 0]}, "faster"),
        ({"type": "uniform", "velocity_mps": [0, float("nan"), 0]}, "velocity_mps"),
        ({"type": "swell"}, "swell"),
    ],
)
def test_bad_configs_are_refused(entry, words):
    with pytest.raises(ConfigError, match=words):
        configs(entry)
