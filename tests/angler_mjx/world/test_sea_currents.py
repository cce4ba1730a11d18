"""Depth profiles and tides: what is drawn of their tables, and what is refused."""

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
M2 = {"name": "M2", "major_mps": 0.5, "minor_mps": -0.1, "inclination_deg": 30, "phase_deg": 70}
K1 = {"name": "K1", "major_mps": 0.2}


class File(FileModel):
    current: tuple[currents.CurrentConfig, ...] = Field(default=())


def configs(*entries):
    return parse_model(File, {"current": list(entries)}, source="test").current


def drawn(entry, n_world):
    config = configs(entry)

    def one(key):
        return currents.sample_current(currents.build_samplers(config, 60.0), key, LO, HI)[0]

    return quickly(jax.vmap(one))(jax.random.split(jax.random.key(1), n_world))


def test_given_profile_has_the_velocities_of_its_knots():
    entry = {
        "type": "depth_profile",
        "depth_m": [0, 5, 20],
        "velocity_mps": [[0.4, 0.0], [0.1, 0.2], [0.0, 0.1]],
    }
    (profile,) = currents.sample_current(
        currents.build_samplers(configs(entry), 60.0), jax.random.key(0), LO, HI
    )
    for depth, level in zip(entry["depth_m"], entry["velocity_mps"], strict=True):
        v = currents.velocity((profile,), jnp.array([3.0, 1.0, -depth]), jnp.zeros(()))
        np.testing.assert_allclose(v, [*level, 0.0], atol=1e-7)
    twice = currents.scale_current((profile,), jnp.array(2.0))
    p, t = jnp.array([0.0, 0.0, -3.0]), jnp.zeros(())
    np.testing.assert_allclose(
        currents.velocity(twice, p, t), 2 * currents.velocity((profile,), p, t), rtol=1e-6
    )


def test_drawn_profile_keeps_its_spans():
    entry = {
        "type": "depth_profile",
        "depth_m": [0, 4, 9, 20],
        "speed_mps": [0.1, 0.4],
        "turn_deg": 20,
    }
    knots = np.asarray(drawn(entry, 500).knots_mps)
    speed = np.linalg.norm(knots, axis=2)
    assert speed.min() >= 0.1 - 1e-6
    assert speed.max() <= 0.4 + 1e-6
    assert speed.max() - speed.min() > 0.28
    heading = np.arctan2(knots[..., 1], knots[..., 0])
    turn = np.angle(np.exp(1j * np.diff(heading, axis=1)))
    assert np.abs(turn).max() <= np.radians(20) + 1e-5
    assert np.abs(turn).max() > np.radians(19)
    # Directions at the surface fill the circle: the mean of 500 fair unit vectors.
    assert abs(np.exp(1j * heading[:, 0]).mean()) < 3 / np.sqrt(500)


def test_tide_of_a_start_is_that_of_its_table():
    entry = {"type": "tide", "constituents": [M2, K1], "start_s": [3e8, 3e8]}
    (tide,) = currents.sample_current(
        currents.build_samplers(configs(entry), 60.0), jax.random.key(0), LO, HI
    )
    for t in (0.0, 7000.0, 40_000.0):
        v = currents.velocity((tide,), jnp.zeros(3), jnp.array(t))
        hours = (3e8 + t) / 3600
        m2 = np.radians(28.9841042 * hours - 70)
        k1 = np.radians(15.0410686 * hours)
        u = np.exp(1j * np.radians(30)) * (0.5 * np.cos(m2) - 0.1j * np.sin(m2)) + 0.2 * np.cos(k1)
        np.testing.assert_allclose(v, [u.real, u.imag, 0.0], atol=2e-6)


def test_tides_begin_at_times_of_their_own():
    entry = {"type": "tide", "constituents": [M2, K1]}
    phases = np.asarray(drawn(entry, 400).phase_rad)
    assert phases.min() >= 0
    assert phases.max() <= 2 * np.pi
    # The two constituents begin at one time: their phases differ by what lies between their speeds.
    assert np.all(np.abs(np.exp(1j * phases).mean(axis=0)) < 3 / np.sqrt(400))
    assert len(np.unique(phases[:, 0])) > 390


@pytest.mark.parametrize(
    ("entry", "words"),
    [
        ({"type": "tide"}, "constituents"),
        ({"type": "tide", "constituents": [{"name": "M9", "major_mps": 0.1}]}, "there is M2, S2"),
        ({"type": "tide", "constituents": [K1, K1]}, "K1 is there twice"),
        (
            {"type": "tide", "constituents": [{"name": "M2", "major_mps": 0.1, "minor_mps": -0.2}]},
            "minor_mps = -0.2",
        ),
        ({"type": "tide", "constituents": [K1], "start_s": [2, 1]}, "low <= high"),
        (
            {"type": "depth_profile", "depth_m": [0, 5], "velocity_mps": [[0.1, 0.0]]},
            "velocity_mps",
        ),
        (
            {"type": "depth_profile", "depth_m": [5, 0], "speed_mps": [0.1, 0.2]},
            "must be below the last",
        ),
        ({"type": "depth_profile", "depth_m": [0, 5]}, "either velocity_mps or speed_mps"),
        ({"type": "depth_profile", "depth_m": [0, 5], "speed_mps": [0.2, 0.1]}, "low <= high"),
    ],
)
def test_bad_tables_are_refused(entry, words):
    with pytest.raises(ConfigError, match=words):
        configs(entry)
