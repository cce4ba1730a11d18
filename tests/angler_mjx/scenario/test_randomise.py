"""What is drawn of robots, water and instruments: banks, ranges, refusals, and what flies of it."""

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.planning.build_problem import build_team
from angler_mjx.robot.sensing import params as instruments
from angler_mjx.robot.sensing import suite
from angler_mjx.robot.sensing.config import SensorsConfig
from angler_mjx.robot.sensing.readings import Truth
from angler_mjx.robot.vehicles import library
from angler_mjx.robot.vehicles.variation import Variation, apply_variation
from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import load_scenario
from angler_mjx.sim import fleet

SPANS = {
    "mass": [0.9, 1.1],
    "buoyancy": [0.97, 1.03],
    "damping": [0.5, 1.5],
    "added_mass": [0.6, 1.4],
    "thrust": [0.8, 1.1],
    "battery_v": [14.0, 17.0],
}
FLEET = [{"vehicle": "bluerov2_heavy", "count": 2}, {"vehicle": "bluerov2"}]


def drawn(**table):
    return load_scenario("reef_fleet", fleet=FLEET, randomise={"variants": 8, **table})


def variations(scenario, robot=0):
    return [kind.variation for kind in scenario.members()[robot].variants]


def test_every_eighth_of_every_range_is_drawn_once():
    bank = variations(drawn(**SPANS))
    assert [one.number for one in bank] == list(range(8))
    for name, (low, high) in SPANS.items():
        values = np.array([getattr(one, name) for one in bank], float).reshape(8, -1)
        eighths = np.floor(8 * (values - low) / (high - low))
        for column in eighths.T:
            assert sorted(column) == list(range(8)), name


def test_a_bank_hangs_on_its_seed_entry_and_set_alone():
    scenario = drawn(**SPANS)
    assert variations(scenario) == variations(scenario, 1)
    assert variations(scenario) != variations(scenario, 2)
    assert variations(drawn(seed=1, **SPANS)) != variations(scenario)
    other = load_scenario("reef_fleet", seed=9, fleet=FLEET[:1], randomise=scenario.randomise)
    assert variations(other) == variations(scenario)


def test_faults_come_as_often_as_asked():
    bank = variations(drawn(variants=1024, fault_probability=0.25, fault_health=[0.0, 0.5]))
    thrust = np.array([one.thrust for one in bank])
    np.testing.assert_allclose(np.mean(thrust < 1.0, axis=0), 0.25, atol=1e-9)
    # Which are faulty together is chance: 8 thrusters, each in a quarter of the variants. A share
    # of a tenth of 1,024 has a standard deviation of 0.009; four of those.
    assert abs(np.mean(np.sum(thrust < 1.0, axis=1) == 0) - 0.75**8) < 0.04
    assert thrust[thrust < 1.0].max() <= 0.5
    assert thrust.max() == 1.0


def test_a_varied_vehicle_has_what_was_drawn_and_still_can_be():
    config = library.load_vehicle("bluerov2_heavy")
    name = "von_benzon2022"
    made = apply_variation(
        config,
        name,
        Variation(mass=1.1, buoyancy=0.9, damping=(2.0,) * 6, added_mass=(1, 4, 1, 1, 9, 1)),
    ).find_set(name)
    before = config.find_set(name)
    assert made.rigid_body.mass_kg == pytest.approx(1.1 * before.rigid_body.mass_kg)
    assert made.buoyancy.volume_m3 == pytest.approx(0.9 * before.buoyancy.volume_m3)
    np.testing.assert_allclose(made.damping.linear, 2.0 * np.array(before.damping.linear))
    added, was = np.array(made.added_mass.coefficients), np.array(before.added_mass.coefficients)
    assert added[1, 1] == pytest.approx(4 * was[1, 1])
    assert added[1, 4] == pytest.approx(6 * was[1, 4])
    np.testing.assert_array_equal(added, added.T)
    assert np.linalg.eigvalsh(added).min() > 0
    assert config.find_set(name) is before


@pytest.mark.parametrize("visible", [False, True])
def test_controllers_and_planners_know_what_they_are_told(visible):
    kinds = fleet.build_fleet(drawn(**SPANS, visible=visible).members(), multibody=False)
    told, said = kinds.control.vehicle_model, library.load_vehicle("bluerov2_heavy")
    mass = np.asarray(told.mass_kg)[:8]
    nominal = said.find_set(None).rigid_body.mass_kg
    assert bool(np.allclose(mass, nominal)) is not visible
    assert not np.allclose(kinds.control.vehicle.mass_kg[:8], nominal)
    # Voltage: the thrust that the allocation counts on.
    reach = np.asarray(kinds.control.allocation.thrust_n)[:8, -1]
    assert bool(np.ptp(reach) > 1.0) is visible
    world = (jnp.zeros((16, 3)), jnp.zeros(16), jnp.ones((16, 3)))
    speeds = np.asarray(build_team(kinds.control, *world).terminal_speed_mps)[:8, 0]
    assert bool(np.ptp(speeds) > 0.1) is visible


def test_worlds_have_their_own_current_and_noise():
    open_water = {"preset": "open", "currents": [{"type": "uniform", "velocity_mps": [1, 0, 0]}]}
    noisy = [{"vehicle": "bluerov2", "estimate": "noisy", "count": 2}]
    table = {"current": [0.5, 2.0], "sensor_noise": [0.0, 3.0]}
    simulator = Simulator(
        load_scenario("open_water_current", world=open_water, fleet=noisy, randomise=table), tile=64
    )
    worlds = simulator.worlds()
    factor, noise = np.asarray(worlds.factors.current), np.asarray(worlds.factors.sensor_noise)
    (uniform,) = worlds.environment.current
    np.testing.assert_allclose(uniform.velocity_mps[:, 0], factor, rtol=1e-6)
    assert 0.5 <= factor.min() < 0.65
    assert 1.85 < factor.max() <= 2.0
    assert noise.shape == (64, 2)
    assert noise.min() < 0.3
    assert noise.max() > 2.7
    assert abs(np.corrcoef(noise.T)[0, 1]) < 0.5  # four standard deviations of 64 pairs
    assert len(np.unique(noise)) == 128


def test_instruments_with_twice_the_noise_err_twice_as_much():
    sensors = instruments.build_sensors(SensorsConfig(), 0.05, 9.81)
    truth = Truth(
        p=jnp.array([1.0, 2.0, -3.0]),
        q=jnp.array([1.0, 0.0, 0.0, 0.0]),
        nu=jnp.full(6, 0.1),
        altitude_m=jnp.array(2.0),
    )
    key = jax.random.key(3)
    loud = instruments.scale_noise(sensors, jnp.array(2.0))
    off = [
        np.asarray(suite.disturb_truth(one, key, jnp.int32(5), truth).p - truth.p, float)
        for one in (sensors, loud, instruments.scale_noise(sensors, jnp.array(0.0)))
    ]
    np.testing.assert_allclose(off[1], 2 * off[0], rtol=1e-4)
    np.testing.assert_array_equal(off[2], 0.0)
    # Every deviation is scaled, nothing else.
    for (path, a), b in zip(
        jax.tree_util.tree_leaves_with_path(sensors), jax.tree.leaves(loud), strict=True
    ):
        twice = "std" in jax.tree_util.keystr(path)
        np.testing.assert_array_equal(np.asarray(b), np.asarray(a) * (2 if twice else 1))


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"mass": [1.1, 0.9]}, ["randomise.mass", "the lower end comes first"]),
        ({"mass": [0.0, 1.0]}, ["randomise.mass", "0.01"]),
        ({"mass": [1.0, 9.0]}, ["randomise", "fleet[0]", "sinks", "9 times", "narrow"]),
        ({"buoyancy": [1.0, 9.0]}, ["fleet[0]", "rises", "in heave"]),
        ({"battery_v": [5.0, 16.0]}, ["fleet[0]", "5 V", "10 V"]),
        ({"sensor_noise": [0.5, 2.0]}, ["randomise.sensor_noise", "true state", "estimate"]),
        ({"battery_v": [14.0, 30.0]}, ["randomise.battery_v", "30 V", "20 V"]),
        ({"fault_health": [0.1, 0.5]}, ["fault_health", "fault_probability"]),
        ({"variants": 0}, ["randomise.variants", "1"]),
        ({"wind": [0.0, 1.0]}, ["randomise.wind", "unknown key"]),
    ],
)
def test_what_cannot_be_is_refused(table, said):
    with pytest.raises(ConfigError) as error:
        drawn(**table)
    for words in said:
        assert words in str(error.value)


IDENTIFIED = {"vehicle": "bluerov2_heavy", "parameter_set": "hinsdale2023_identified", "count": 2}


def uncertain(entry=IDENTIFIED, **table):
    table = {"variants": 1024, "uncertainty": True, **table}
    return load_scenario("reef_fleet", fleet=[entry], randomise=table)


@pytest.mark.parametrize("vehicle", ["bluerov2_heavy", "bluerov2_heavy_alpha5"])
def test_uncertain_sets_are_sampled_with_their_spread(vehicle):
    """Means and standard deviations of 1,024 strata, and correlations within four of theirs."""
    scenario = uncertain({**IDENTIFIED, "vehicle": vehicle})
    table = library.load_vehicle(vehicle).find_set(IDENTIFIED["parameter_set"]).uncertainty
    sampled = np.array([one.deviations for one in variations(scenario)])
    spread = table.standard_deviations
    np.testing.assert_allclose(sampled.mean(axis=0) / spread, 0.0, atol=0.02)
    np.testing.assert_allclose(sampled.std(axis=0) / spread, 1.0, atol=0.08)
    np.testing.assert_allclose(np.corrcoef(sampled.T), table.correlation, atol=4.0 / 32.0)


def test_other_samples_are_the_same_with_uncertainty():
    plain, both = (
        drawn(fault_probability=0.1, **SPANS),
        uncertain(IDENTIFIED, variants=8, fault_probability=0.1, **SPANS),
    )
    same = load_scenario(
        "reef_fleet",
        fleet=[IDENTIFIED],
        randomise={"variants": 8, "fault_probability": 0.1, **SPANS},
    )
    assert all(one.deviations for one in variations(both))
    assert not any(one.deviations for one in variations(plain))
    for one, other in zip(variations(both), variations(same), strict=True):
        assert replace(one, deviations=()) == other
    assert both.digest() != same.digest()


def test_a_set_without_uncertainty_is_refused_by_name():
    with pytest.raises(ConfigError) as error:
        uncertain({**IDENTIFIED, "parameter_set": "wu2018"})
    for words in ("fleet[0]", "randomise.uncertainty", "'wu2018'", "hinsdale2023_identified"):
        assert words in str(error.value)
    with pytest.raises(ConfigError, match="sets with one: none"):
        uncertain({"vehicle": "bluerov2"})


def test_variants_of_uncertain_sets_are_listed_and_built():
    scenario = uncertain(variants=4)
    rows = fleet.describe_variants(scenario.members())
    labels = library.load_vehicle("bluerov2_heavy").find_set("hinsdale2023_identified")
    assert {len(row["drawn"]["deviations"]) for row in rows} == {len(labels.uncertainty.labels)}
    assert "deviations" not in fleet.describe_variants(drawn(**SPANS).members())[0]["drawn"]
    vehicles = fleet.build_fleet(scenario.members(), multibody=False).control
    for told, truth in ((vehicles.vehicle_model, 1), (vehicles.vehicle, 4)):
        assert len(np.unique(np.asarray(told.volume_m3))) == truth


def test_current_of_still_water_is_refused():
    with pytest.raises(ConfigError, match=r"randomise\.current: there is no current"):
        load_scenario("reef_fleet", world={"currents": []}, randomise={"current": [0.5, 1.0]})


def test_a_table_that_says_nothing_changes_no_problem():
    plain = load_scenario("reef_fleet")
    same = load_scenario("reef_fleet", randomise={"variants": 4, "mass": [1.0, 1.0]})
    assert same.digest() == plain.digest()
    assert same.members() == plain.members()
    assert drawn(mass=[0.9, 1.0]).digest() != drawn().digest()


def test_files_say_what_each_variant_is():
    members = drawn(**SPANS).members()
    rows = fleet.describe_variants(members)
    kinds = fleet.list_variants(members)
    assert [row["variant"] for row in rows] == list(range(len(kinds))) == list(range(16))
    for row, kind in zip(rows, kinds, strict=True):
        assert row["battery_v"] == kind.variation.battery_v
        again = Variation(
            **{k: tuple(v) if isinstance(v, list | tuple) else v for k, v in row["drawn"].items()},
            battery_v=row["battery_v"],
        )
        assert again == kind.variation
