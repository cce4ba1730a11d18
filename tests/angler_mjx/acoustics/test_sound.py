import numpy as np
import pytest

from angler_mjx.acoustics import sound


def test_speed_is_that_of_mackenzies_check_value():
    # Mackenzie 1981: T = 25, S = 35, D = 1000 m.
    assert sound.speed_mps(25.0, 35.0, 1000.0) == pytest.approx(1550.744, abs=5e-4)


def test_thorp_is_his_equation_in_decibels_per_kiloyard():
    # Thorp 1967 has the relaxations in dB/kyd; the later terms came in dB/km.
    for f in (1.0, 5.0, 10.0, 28.0, 50.0):
        relaxed = 0.1 * f**2 / (1 + f**2) + 40 * f**2 / (4100 + f**2)
        expected = relaxed / 0.9144 + 2.75e-4 * f**2 + 0.003
        assert sound.thorp_db_per_km(f) == pytest.approx(expected, rel=0.01)


def test_francois_and_garrison_as_others_compute_it():
    # 13.96602: example of the R package sonar 1.0.2, which takes 273.15 where the paper has 273.
    found = sound.francois_garrison_db_per_km(50.0, 0.0, 35.0, 0.0, 6.0)
    assert found == pytest.approx(13.96602, rel=2e-3)


@pytest.mark.parametrize(("khz", "db_per_km"), [(200.0, 50.0), (400.0, 100.0)])
def test_absorption_at_the_frequencies_of_echo_sounders(khz, db_per_km):
    # Manual of R2Sonic's Sonic 2024, v5.0, section 12.3.2: "approximately", for 35 ppt.
    for equation in (sound.francois_garrison_db_per_km, sound.ainslie_mccolm_db_per_km):
        assert equation(khz, 10.0, 35.0, 10.0, 8.0) == pytest.approx(db_per_km, rel=0.15)


def test_ainslie_and_mccolm_keep_within_ten_per_cent_of_francois_and_garrison():
    # Their claim, for ordinary seas.
    for khz in (0.5, 2.0, 10.0, 28.0, 100.0, 400.0):
        for t in (0.0, 10.0, 20.0):
            water = (t, 35.0, 100.0, 8.0)
            one = sound.ainslie_mccolm_db_per_km(khz, *water)
            assert one == pytest.approx(sound.francois_garrison_db_per_km(khz, *water), rel=0.12)


def test_fresh_water_absorbs_little():
    salt, fresh = (sound.francois_garrison_db_per_km(28.0, 10.0, s, 5.0, 8.0) for s in (35.0, 0.0))
    assert 0.0 < fresh < 0.1 * salt


def test_noise_is_the_sum_of_its_four_parts():
    f, s, w = 28.0, 0.5, 5.0
    parts = np.array(
        [
            17 - 30 * np.log10(f),
            40 + 20 * (s - 0.5) + 26 * np.log10(f) - 60 * np.log10(f + 0.03),
            50 + 7.5 * w**0.5 + 20 * np.log10(f) - 40 * np.log10(f + 0.4),
            -15 + 20 * np.log10(f),
        ]
    )
    total = 10 * np.log10(np.sum(10 ** (parts / 10)))
    assert sound.ambient_db(f, s, w) == pytest.approx(total, abs=1e-9)


def test_waves_fall_by_twenty_decibels_a_decade_and_heat_rises_as_much():
    # Wenz 1962: 17 dB a decade or so above 1 kHz, and thermal noise from 100 kHz on.
    assert sound.ambient_db(50.0, 0.0, 10.0) - sound.ambient_db(5.0, 0.0, 10.0) == pytest.approx(
        -19.4, abs=0.7
    )
    assert sound.ambient_db(1000.0, 0.0, 0.0) == pytest.approx(45.0, abs=0.5)
