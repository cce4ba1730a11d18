import numpy as np
import pytest

from angler_mjx.world.acoustics import sound


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


WATERS = [
    (10.0, 35.0, 10.0, 8.0),
    (4.0, 30.0, 1000.0, 7.7),
    (20.0, 38.0, 0.0, 8.2),
    (26.0, 12.0, 50.0, 7.9),
]
"""Temperature, salinity, depth, pH: water above and below 20 degrees, salinity other than 35."""


@pytest.mark.parametrize("khz", [0.3, 1.0, 28.0, 100.0, 600.0])
@pytest.mark.parametrize(("t", "s", "d", "ph"), WATERS)
def test_francois_and_garrison_is_the_equation_of_the_paper(khz, t, s, d, ph):
    """Equations 2 to 10 of part II, term by term: A1 P1 of boric acid, A2 P2, A3 P3."""
    theta, c = 273 + t, 1412 + 3.21 * t + 1.19 * s + 0.0167 * d
    a1, p1 = 8.86 / c * 10 ** (0.78 * ph - 5), 1
    a2, p2 = 21.44 * s / c * (1 + 0.025 * t), 1 - 1.37e-4 * d + 6.2e-9 * d**2
    warm, cold = [3.964e-4, -1.146e-5, 1.45e-7, -6.5e-10], [4.937e-4, -2.59e-5, 9.11e-7, -1.5e-8]
    a3 = np.polynomial.polynomial.polyval(t, cold if t <= 20 else warm)
    p3 = 1 - 3.83e-5 * d + 4.9e-10 * d**2
    f1 = 2.8 * (s / 35) ** 0.5 * 10 ** (4 - 1245 / theta)
    f2 = 8.17 * 10 ** (8 - 1990 / theta) / (1 + 0.0018 * (s - 35))
    f = khz
    want = a1 * p1 * f1 * f**2 / (f1**2 + f**2) + a2 * p2 * f2 * f**2 / (f2**2 + f**2)
    want += a3 * p3 * f**2
    assert sound.francois_garrison_db_per_km(f, t, s, d, ph) == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize("khz", [0.3, 1.0, 28.0, 100.0, 600.0])
@pytest.mark.parametrize(("t", "s", "d", "ph"), WATERS)
def test_ainslie_and_mccolm_is_the_equation_of_the_paper(khz, t, s, d, ph):
    f, z = khz, d / 1000
    f1, f2 = 0.78 * (s / 35) ** 0.5 * np.exp(t / 26), 42 * np.exp(t / 17)
    want = 0.106 * f1 * f**2 / (f**2 + f1**2) * np.exp((ph - 8) / 0.56)
    want += 0.52 * (1 + t / 43) * (s / 35) * f2 * f**2 / (f**2 + f2**2) * np.exp(-z / 6)
    want += 0.00049 * f**2 * np.exp(-(t / 27 + z / 17))
    assert sound.ainslie_mccolm_db_per_km(f, t, s, d, ph) == pytest.approx(want, rel=1e-12)


@pytest.mark.parametrize(("t", "s", "d"), [(4.0, 30.0, 900.0), (20.0, 38.0, 0.0), (9, 34, 300)])
def test_speed_is_about_that_of_medwins_equation(t, s, d):
    """J. Acoust. Soc. Am. 58, 1975: to 0.6 m/s, 0 to 35 degrees, down to 1,000 m."""
    medwin = 1449.2 + 4.6 * t - 0.055 * t**2 + 0.00029 * t**3 + (1.34 - 0.01 * t) * (s - 35)
    assert sound.speed_mps(t, s, d) == pytest.approx(medwin + 0.016 * d, abs=0.6)


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
