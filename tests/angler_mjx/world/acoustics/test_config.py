import re

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.world.acoustics.access import Aloha, Tdma
from angler_mjx.world.acoustics.config import AcousticsConfig, refuse_acoustics
from angler_mjx.world.acoustics.link import LinkBudget, RangeLink

SIZE_M = (24.0, 24.0, 24.0)


def channel(robots=4, horizon_s=120.0, **table):
    return AcousticsConfig.model_validate(table).channel(robots, SIZE_M, 0.05, horizon_s)


def test_perfect_is_the_default_and_no_channel():
    plain = load_scenario("reef_fleet")
    assert plain.acoustics.model == "perfect"
    assert plain.sim_spec().acoustics is None
    assert (
        load_scenario("reef_fleet", acoustics={"model": "perfect"}).sim_spec() == plain.sim_spec()
    )


def test_a_channel_poses_the_same_problems():
    plain, talking = (
        load_scenario("reef_fleet"),
        load_scenario("reef_fleet", acoustics={"model": "budget"}),
    )
    assert talking.sim_spec().acoustics is not None
    assert talking.digest() == plain.digest()


def test_numbers_of_the_nanomodem_by_hand():
    """168 dB, 28 kHz, 8 kHz wide, 640 bit/s; it is said to reach farther than 2 km."""
    made = channel(model="budget", bits=128, fading="none")
    assert isinstance(made.access, Tdma)
    assert isinstance(made.link, LinkBudget)
    assert made.packet_s == pytest.approx(0.2)
    assert made.link.snr_db == pytest.approx(168.0 - 37.6 - 39.03, abs=0.05)
    assert made.link.success(2000.0, 0.0) > 0.999
    # 24 m cubed is 41.6 m across: 28 ms more than the packet, in steps of 50 ms.
    assert made.access.slot == 5


def test_a_range_is_a_channel():
    made = channel(model="range", range_m=10.0)
    assert made.link == RangeLink(range_m=10.0)
    assert channel(model="range", range_m=1.0).link.success(1.0, 0.0) == 1.0


BOUNDS = {
    "interval_s": (1e-9, 86400.0),
    "guard_s": (0.0, 60.0),
    "bits": (1, 10**6),
    "bit_rate_bps": (1e-9, 1e6),
    "lost_after_s": (1e-9, 86400.0),
    "sound_mps": (1300.0, 1700.0),
    "temperature_c": (0.0, 35.0),
    "salinity_ppt": (0.0, 45.0),
    "depth_m": (0.0, 8000.0),
    "ph": (7.0, 9.0),
    "spreading": (1.0, 2.0),
    "source_level_db": (60.0, 220.0),
    "shipping": (0.0, 1.0),
    "wind_mps": (0.0, 50.0),
    "self_noise_db": (-50.0, 200.0),
    "rock_db_per_m": (0.0, 1000.0),
}
"""Least and greatest value of keys, of the sea and of modems that are sold."""


@pytest.mark.parametrize("key", BOUNDS)
def test_numbers_beyond_what_there_is_are_refused(key):
    low, high = BOUNDS[key]
    step = 1 if isinstance(low, int) else 0.5
    for value in (low, high):
        assert getattr(AcousticsConfig.model_validate({key: value}), key) == value
    for value in (low - step, high + step):
        with pytest.raises(ValueError, match=key):
            AcousticsConfig.model_validate({key: value})


def test_chances_of_aloha_keep_the_rate():
    made = channel(model="budget", access="aloha", interval_s=20.0)
    assert isinstance(made.access, Aloha)
    assert not made.access.slotted
    # Mean of so many chances at rest and a geometric number of free ones.
    chances = made.access.rests - 1 + 1 / made.access.probability
    assert chances * made.access.chance * 0.05 == pytest.approx(20.0)
    slots = channel(model="budget", access="slotted_aloha", interval_s=20.0).access
    assert slots.chance * 0.05 / slots.probability == pytest.approx(20.0)


@pytest.mark.parametrize(
    ("table", "says"),
    [
        ({"model": "range"}, "give range_m"),
        ({"model": "budget", "source_level_db": 62.0}, "source_level_db = 62: .* raise it"),
        ({"model": "budget", "self_noise_db": 150.0}, "not one in a thousand"),
        ({"model": "range", "range_m": 0.5}, "range_m = 0.5: .* give more"),
        ({"model": "budget", "bits": 10**6}, "bits = 1000000: 4 slots .* longer than the horizon"),
        ({"model": "budget", "guard_s": 0.01}, "guard_s = 0.01: .* leave it out, or give more"),
        (
            {"model": "budget", "access": "aloha", "interval_s": 0.2},
            "interval_s = 0.2: .* give more",
        ),
        (
            {"model": "budget", "access": "slotted_aloha", "interval_s": 0.1},
            "interval_s = 0.1: .* give more",
        ),
        ({"model": "budget", "bandwidth_khz": 60.0}, "take a narrower band"),
    ],
)
def test_what_cannot_be_is_refused(table, says):
    with pytest.raises(ValueError, match=re.compile(says, re.DOTALL)):
        channel(**table)


def test_a_scenario_names_the_table():
    with pytest.raises(ConfigError, match=r"acoustics\.bits .*= 1000000: 4 slots"):
        load_scenario("reef_fleet", acoustics={"model": "budget", "bits": 10**6})
    with pytest.raises(ConfigError, match=r"replan_hz.*acoustics"):
        load_scenario("reef_fleet", acoustics={"model": "budget"}, planner={"replan_hz": 1.0})
    with pytest.raises(ConfigError, match=r"store\.also"):
        load_scenario("reef_fleet", store={"also": ["acoustics"]})


def test_who_hears_nothing_refuses_the_table():
    refuse_acoustics(AcousticsConfig(), "nobody listens")
    talks = AcousticsConfig(model="range", range_m=10.0)
    with pytest.raises(ConfigError, match=r"acoustics\.model = 'range': nobody listens"):
        refuse_acoustics(talks, "nobody listens")
