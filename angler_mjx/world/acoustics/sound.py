"""Speed of sound in sea water, its absorption, and ambient noise."""

import math


def speed_mps(temperature_c: float, salinity_ppt: float, depth_m: float) -> float:
    """Return the speed of sound in sea water, m/s.

    Mackenzie, Nine-term equation for sound speed in the oceans, J. Acoust. Soc. Am. 70, 1981; for 2
    to 30 degrees, 25 to 40 parts per thousand, 0 to 8000 m, with a standard error of 0.07 m/s.
    """
    t, s, z = temperature_c, salinity_ppt - 35.0, depth_m
    return (
        1448.96
        + 4.591 * t
        - 5.304e-2 * t**2
        + 2.374e-4 * t**3
        + 1.340 * s
        + 1.630e-2 * z
        + 1.675e-7 * z**2
        - 1.025e-2 * t * s
        - 7.139e-13 * t * z**3
    )


def thorp_db_per_km(frequency_khz: float) -> float:
    """Return the absorption in sea water of 4 degrees at 1 km, dB/km.

    Thorp, Analytic description of the low-frequency attenuation coefficient, J. Acoust. Soc. Am.
    42, 1967, in the form for dB/km of Stojanovic, 2007: from some hundred Hz to 50 kHz.
    """
    f2 = frequency_khz**2
    return 0.11 * f2 / (1.0 + f2) + 44.0 * f2 / (4100.0 + f2) + 2.75e-4 * f2 + 0.003


def francois_garrison_db_per_km(
    frequency_khz: float, temperature_c: float, salinity_ppt: float, depth_m: float, ph: float
) -> float:
    """Return the absorption in sea water, dB/km.

    Francois, Garrison, Sound absorption based on ocean measurements, part II, J. Acoust. Soc. Am.
    72, 1982: boric acid, magnesium sulphate and pure water; 0.4 to 1000 kHz, within 5 %.
    """
    f, t, s, z = frequency_khz, temperature_c, salinity_ppt, depth_m
    kelvin = 273.0 + t
    c = 1412.0 + 3.21 * t + 1.19 * s + 0.0167 * z
    boric = 8.86 / c * math.pow(10.0, 0.78 * ph - 5.0)
    f1 = 2.8 * math.sqrt(s / 35.0) * math.pow(10.0, 4.0 - 1245.0 / kelvin)
    sulphate = 21.44 * s / c * (1.0 + 0.025 * t)
    sulphate *= 1.0 - 1.37e-4 * z + 6.2e-9 * z**2
    f2 = 8.17 * math.pow(10.0, 8.0 - 1990.0 / kelvin) / (1.0 + 0.0018 * (s - 35.0))
    if t <= 20.0:
        water = 4.937e-4 - 2.59e-5 * t + 9.11e-7 * t**2 - 1.50e-8 * t**3
    else:
        water = 3.964e-4 - 1.146e-5 * t + 1.45e-7 * t**2 - 6.5e-10 * t**3
    water *= 1.0 - 3.83e-5 * z + 4.9e-10 * z**2
    return f**2 * (_relaxation_term(boric, f1, f) + sulphate * f2 / (f2**2 + f**2) + water)


def ainslie_mccolm_db_per_km(
    frequency_khz: float, temperature_c: float, salinity_ppt: float, depth_m: float, ph: float
) -> float:
    """Return the absorption in sea water, dB/km.

    Ainslie, McColm, A simplified formula for viscous and chemical absorption in sea water, J.
    Acoust. Soc. Am. 103, 1998; within 10 % of Francois and Garrison in most seas.
    """
    f, t, s, z = frequency_khz, temperature_c, salinity_ppt, 1e-3 * depth_m
    f1 = 0.78 * math.sqrt(s / 35.0) * math.exp(t / 26.0)
    f2 = 42.0 * math.exp(t / 17.0)
    boric = 0.106 * math.exp((ph - 8.0) / 0.56)
    sulphate = 0.52 * (1.0 + t / 43.0) * (s / 35.0) * math.exp(-z / 6.0)
    water = 0.00049 * math.exp(-(t / 27.0 + z / 17.0))
    return f**2 * (_relaxation_term(boric, f1, f) + _relaxation_term(sulphate, f2, f) + water)


def _relaxation_term(strength: float, at_khz: float, frequency_khz: float) -> float:
    """Return the absorption over squared frequency of a relaxation process at ``at_khz``."""
    if at_khz == 0.0:  # Boric acid in fresh water, which has none.
        return 0.0
    return strength * at_khz / (at_khz**2 + frequency_khz**2)


def ambient_db(frequency_khz: float, shipping: float, wind_mps: float) -> float:
    """Return the spectral density of sea noise, dB re 1 uPa^2/Hz: turbulence, ships, waves, heat.

    Coates, Underwater Acoustic Systems, 1989, after Wenz, Acoustic ambient noise in the ocean, J.
    Acoust. Soc. Am. 34, 1962; as given by Stojanovic, 2007.

    Args:
        frequency_khz: above 0.
        shipping: from 0, none, to 1, dense.
        wind_mps: wind speed, m/s.
    """
    log = math.log10(frequency_khz)
    turbulence = 17.0 - 30.0 * log
    ships = 40.0 + 20.0 * (shipping - 0.5) + 26.0 * log - 60.0 * math.log10(frequency_khz + 0.03)
    waves = 50.0 + 7.5 * math.sqrt(wind_mps) + 20.0 * log
    waves -= 40.0 * math.log10(frequency_khz + 0.4)
    heat = -15.0 + 20.0 * log
    return added_db(turbulence, ships, waves, heat)


def added_db(*levels_db: float) -> float:
    """Return the level of the sum of powers, dB."""
    return 10.0 * math.log10(sum(math.pow(10.0, 0.1 * level) for level in levels_db))
