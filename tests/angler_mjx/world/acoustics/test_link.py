import math

import jax.numpy as jnp
import numpy as np
import pytest
from scipy import optimize

from angler_mjx.world.acoustics.link import LinkBudget, RangeLink, bit_error, packet_success
from angler_mjx.world.acoustics.link import transmission_loss_db as loss_db

RATIOS = 10 ** (np.array([-5.0, 0.0, 5.0, 10.0, 25.0]) / 10)


@pytest.mark.parametrize("modulation", ["bpsk", "fsk"])
def test_white_noise_alone(modulation):
    expected = [
        0.5 * math.erfc(math.sqrt(g)) if modulation == "bpsk" else 0.5 * math.exp(-g / 2)
        for g in RATIOS
    ]
    np.testing.assert_allclose(bit_error(RATIOS, modulation, "none"), expected, rtol=1e-12)


@pytest.mark.parametrize("modulation", ["bpsk", "fsk"])
def test_rayleigh_fading_is_the_mean_over_an_exponential_ratio(modulation):
    """By quadrature of the error in white noise over the distribution of the ratio."""
    share = (np.arange(400_000) + 0.5) / 400_000
    draws = -np.log1p(-share)
    for ratio, found in zip(RATIOS, bit_error(RATIOS, modulation, "rayleigh"), strict=True):
        mean = np.mean(bit_error(ratio * draws, modulation, "none"))
        assert found == pytest.approx(mean, rel=2e-3)


def test_arrays_of_jax_give_the_same_numbers():
    for modulation in ("bpsk", "fsk"):
        for fading in ("none", "rayleigh"):
            ours = bit_error(jnp.asarray(RATIOS, jnp.float32), modulation, fading)
            np.testing.assert_allclose(
                ours, bit_error(RATIOS, modulation, fading), rtol=1e-4, atol=1e-30
            )


def test_a_packet_needs_all_its_bits():
    assert packet_success(np.array(0.01), 64) == pytest.approx(0.99**64)
    rng = np.random.default_rng(3)
    right = np.all(rng.uniform(size=(20_000, 64)) > 0.01, axis=1).mean()
    assert right == pytest.approx(packet_success(np.array(0.01), 64), abs=0.012)


def test_loss_of_a_kilometre():
    # 10 * 1.5 * 3 decades, and 6 dB absorbed.
    assert loss_db(np.array(1000.0), 1.5, 6e-3) == pytest.approx(51.0)
    assert loss_db(np.array(0.1), 1.5, 0.0) == 0.0


def test_budget_by_hand():
    """168 dB sent, 37.6 dB/Hz of noise over 8 kHz, 640 bit/s: what arrives at 2 km."""
    noise_db = 37.6 + 10 * math.log10(8000)
    link = LinkBudget(
        snr_db=168 - noise_db,
        bit_db=10 * math.log10(8000 / 640),
        spreading=1.5,
        absorption_db_per_m=6.1e-3,
        bits=128,
        modulation="bpsk",
        fading="rayleigh",
    )
    snr_db = 168 - noise_db - 15 * math.log10(2000) - 0.0061 * 2000
    assert link.snr(np.array(2000.0), 0.0) == pytest.approx(snr_db)
    g = 10 ** ((snr_db + 10 * math.log10(12.5)) / 10)
    error = 0.5 * (1 - math.sqrt(g / (1 + g)))
    assert link.success(np.array(2000.0), 0.0) == pytest.approx((1 - error) ** 128, rel=1e-6)
    near, far = link.success(np.array([10.0, 20_000.0]), 0.0)
    assert near > 0.999 > 0.01 > far
    assert link.success(np.array(2000.0), 60.0) < link.success(np.array(2000.0), 0.0)


@pytest.mark.parametrize("rock_db", [0.0, 7.5])
def test_a_modem_drowns_others_where_it_is_louder_than_the_noise(rock_db):
    """Up to the distance at which 10 k log10(r) + a r eats up the signal (SciPy's root)."""
    link = LinkBudget(
        snr_db=60.0,
        bit_db=11.0,
        spreading=1.5,
        absorption_db_per_m=6e-3,
        bits=64,
        modulation="bpsk",
        fading="rayleigh",
    )

    def above_noise_db(r):
        return 60.0 - rock_db - 15.0 * math.log10(r) - 6e-3 * r

    for level_db, is_loud in ((20.0, True), (5.9, True), (0.01, True), (-0.01, False), (-6, False)):
        r = optimize.brentq(lambda r, level_db=level_db: above_noise_db(r) - level_db, 1.0, 1e5)
        assert bool(link.loud(np.array(r), rock_db)) == is_loud
        assert bool(link.loud(jnp.array(r), rock_db)) == is_loud


def test_within_a_range_all_is_loud():
    link = RangeLink(range_m=50.0)
    found = link.loud(np.array([1.0, 50.0, 50.1, 1.0]), np.array([0.0, 0.0, 0.0, 0.1]))
    assert found.tolist() == [True, True, False, False]


def test_reach_is_all_or_nothing():
    link = RangeLink(range_m=50.0)
    np.testing.assert_array_equal(link.success(np.array([0.0, 50.0, 50.1]), 0.0), [1, 1, 0])
    assert link.success(np.array(1.0), 0.1) == 0.0
