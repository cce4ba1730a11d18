"""The identified sets of the vehicle files are those of the study's committed results."""

from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_experiments.validate_hinsdale import identify, parameter_set
from angler_experiments.validate_hinsdale.batch import build_batch
from angler_experiments.validate_hinsdale.campaign import read_campaign
from angler_experiments.validate_hinsdale.parameters import LABELS, apply_parameters
from angler_experiments.validate_hinsdale.split import training_stems
from angler_experiments.validate_hinsdale.tracks import build_track
from angler_experiments.validate_hinsdale.vehicle import (
    FOLDED_RAD,
    MASS_KG,
    SOURCE_SET,
    WATER,
    build_campaign_vehicle,
    extra_bodies,
    lift_moment,
)
from angler_mjx.robot.vehicles.library import load_vehicle, locate_vehicle
from angler_mjx.robot.vehicles.params import build_vehicle

from . import recordings

RESULTS = Path(__file__).parents[3] / "docs" / "validation" / "hinsdale.json"
FILES = ("bluerov2_heavy", "bluerov2_heavy_alpha5")


@pytest.fixture(scope="module")
def posterior():
    return parameter_set.read_posterior(RESULTS)


@pytest.fixture(scope="module")
def identified(posterior):
    """Return the vehicle of the campaign as identified."""
    source = build_campaign_vehicle(SOURCE_SET)
    return apply_parameters(source, jnp.asarray(posterior.vector))


@pytest.mark.parametrize("file", FILES)
def test_the_file_holds_what_the_command_writes(file, tmp_path):
    """Written again into a copy; last digits may differ between machines."""
    copy = tmp_path / f"{file}.toml"
    copy.write_text(locate_vehicle(file).read_text(encoding="utf-8"), encoding="utf-8")
    parameter_set.main([str(RESULTS), str(copy)])
    shipped, written = (load_vehicle(name) for name in (file, str(copy)))
    assert list(written.parameter_sets) == list(shipped.parameter_sets)
    pair = [config.find_set(parameter_set.NAME).model_dump() for config in (shipped, written)]
    old, new = (jax.tree.leaves(table) for table in pair)
    assert len(old) == len(new)
    for a, b in zip(old, new, strict=True):
        if isinstance(a, str):
            assert a == b
        else:  # correlations have three decimals
            assert a == pytest.approx(b, rel=2e-3, abs=2e-3)


def test_the_file_is_the_vehicle_of_the_campaign(identified):
    """Of the same water and joints: mass and inertia with added ones, lift, righting moment."""
    made = build_vehicle(load_vehicle("bluerov2_heavy_alpha5"), parameter_set.NAME, 16.0)
    params = identified.params
    close = {"rtol": 2e-3}
    np.testing.assert_allclose(made.mass_kg, params.mass_kg, **close)
    both = [np.diag(x.inertia_kgm2) + np.diag(x.M_A)[3:] for x in (made, params)]
    np.testing.assert_allclose(*both, **close)
    np.testing.assert_allclose(np.diag(made.M_A)[:3], np.diag(params.M_A)[:3], **close)
    for name in ("D_l", "D_q", "volume_m3"):
        np.testing.assert_allclose(getattr(made, name), getattr(params, name), **close)
    for name in ("mass_kg", "volume_m3", "normal_area_m2", "center_of_mass_m"):
        links = [getattr(x.links, name) for x in (made, params)]
        np.testing.assert_allclose(*links, rtol=2e-3, atol=1e-7)
    # About other centres of mass: the blocks of translation are the same.
    added = [x.links.added_volume[:, :3, :3] for x in (made, params)]
    np.testing.assert_allclose(*added, rtol=2e-3, atol=1e-9)
    height, moved = made.p_cb_m[2] * made.volume_m3, params.p_cb_m[2] * params.volume_m3
    net_kg = float(jnp.sum(WATER.density_kgpm3 * made.links.volume_m3 - made.links.mass_kg))
    shift = net_kg * extra_bodies(MASS_KG).center_of_mass_m[2] / WATER.density_kgpm3
    assert float(height) == pytest.approx(float(moved) - shift, rel=2e-3)


def test_net_lift_is_the_campaigns(identified):
    made = build_vehicle(load_vehicle("bluerov2_heavy_alpha5"), parameter_set.NAME, 16.0)
    links = made.links
    lift_kg = WATER.density_kgpm3 * (made.volume_m3 + links.volume_m3.sum())
    weight_kg = made.mass_kg + links.mass_kg.sum()
    lift_n = float(lift_moment(identified, jnp.array(FOLDED_RAD))[0])
    assert WATER.gravity_mps2 * float(lift_kg - weight_kg) == pytest.approx(lift_n, abs=0.02)


@pytest.mark.nightly(by="test_the_file_holds_what_the_command_writes")
def test_the_results_are_those_of_the_recordings(posterior):
    """A step of Gauss and Newton leads less than half a deviation away, and samples spread alike.

    Found is 0.25 deviations of the posterior in the mean square over parameters.
    """
    runs = [run for run in read_campaign(recordings.real_folder()) if run.copy_of is None]
    training = set(training_stems([run.stem for run in runs]))
    batch = build_batch([build_track(run) for run in runs if run.stem in training])
    vehicle, n = build_campaign_vehicle(SOURCE_SET), len(training)
    vector = jnp.asarray(posterior.vector)
    _, gradient, information = jax.jit(identify.normal_equations)(vector, vehicle, batch)
    matrix = np.asarray(information, float).sum(axis=0) + np.eye(len(LABELS))
    slope = np.asarray(gradient, float).sum(axis=0) + np.asarray(vector)
    step = np.linalg.solve(matrix, slope)
    assert np.sqrt(step @ matrix @ step / len(step)) < 0.5
    fit = identify.Fit(vector, jnp.zeros(()), jnp.asarray(matrix - np.eye(len(LABELS))))
    sample = identify.sample_bootstrap(n, len(posterior.samples), 0)
    samples = identify.linearised_samples(fit, vehicle, batch, sample)
    np.testing.assert_allclose(samples.std(axis=0), posterior.samples.std(axis=0), rtol=0.2)
