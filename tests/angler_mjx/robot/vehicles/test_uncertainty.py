"""Uncertainty of parameter sets: what a file may state, and what a deviation changes."""

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.files import parse_model
from angler_mjx.robot.vehicles.config import VehicleConfig
from angler_mjx.robot.vehicles.library import load_vehicle
from angler_mjx.robot.vehicles.params import build_vehicle
from angler_mjx.robot.vehicles.uncertainty import Uncertainty
from angler_mjx.robot.vehicles.variation import Variation, apply_variation

SET = "hinsdale2023_identified"
TWO = {"volume_m3": 1e-4, "link_drag": 0.5, "source": "made up"}


def _with(table, vehicle="bluerov2_heavy_alpha5"):
    data = load_vehicle(vehicle).model_dump()
    data["parameter_sets"]["wu2018"]["uncertainty"] = table
    return parse_model(VehicleConfig, data, source="some.toml")


def test_root_times_normal_numbers_has_the_stated_covariance():
    table = Uncertainty(
        volume_m3=1e-4,
        linear_damping=(0.1, 0.2, 0.3, 0.4, 0.5, 0.6),
        link_mass={"wrist": 0.1},
        correlation=np.where(np.eye(8), 1.0, 0.25).tolist(),
        source="made up",
    )
    spread = table.standard_deviations
    np.testing.assert_array_equal(spread, [1e-4, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.1])
    assert table.labels[0] == "volume_m3"
    assert table.labels[-2:] == ("linear_damping.r", "link_mass.wrist")
    covariance = spread[:, None] * np.array(table.correlation) * spread
    np.testing.assert_allclose(table.root @ table.root.T, covariance, rtol=1e-12)


def test_numbers_that_go_together_share_their_deviation():
    table = Uncertainty(**TWO, correlation=[[1.0, 1.0], [1.0, 1.0]])
    np.testing.assert_allclose(table.root, [[1e-4, 0.0], [0.5, 0.0]])


@pytest.mark.parametrize(
    ("table", "message"),
    [
        ({**TWO, "wind": 1.0}, "uncertainty.wind = 1.0: unknown key"),
        ({"source": "made up"}, "no standard deviation is given"),
        ({**TWO, "volume_m3": -1.0}, "uncertainty.volume_m3"),
        ({**TWO, "volume_m3": 0.01}, "five standard deviations"),
        ({**TWO, "link_mass": {"hand": 0.1}}, "uncertainty.link_mass.hand: no such link"),
        ({**TWO, "correlation": [[1.0]]}, "give 2 rows of 2 values, for volume_m3, link_drag"),
        ({**TWO, "correlation": [[1.0, 0.1], [0.2, 1.0]]}, "must be symmetric"),
        ({**TWO, "correlation": [[1.0, 0.1], [0.1, 0.9]]}, "correlates with itself by 1"),
        ({**TWO, "correlation": [[1.0, 1.5], [1.5, 1.0]]}, "(row 1, link_drag"),
        (
            {
                **TWO,
                "link_added_mass": 0.1,
                "correlation": [[1.0, 0.9, -0.9], [0.9, 1.0, 0.9], [-0.9, 0.9, 1.0]],
            },
            "no negative eigenvalue",
        ),
    ],
)
def test_what_no_numbers_have_is_refused(table, message):
    with pytest.raises(ConfigError) as error:
        _with(table)
    assert message in str(error.value)


def test_a_deviation_changes_what_it_names():
    config = load_vehicle("bluerov2_heavy_alpha5")
    before = config.find_set(SET)
    labels = before.uncertainty.labels
    deviation = dict.fromkeys(labels, 0.0) | {
        "volume_m3": 1e-4,
        "center_of_buoyancy_m.z": 0.002,
        "added_mass.w": np.log(4.0),
        "linear_damping.p": np.log(2.0),
        "quadratic_damping.r": np.log(3.0),
        "link_drag": np.log(5.0),
        "link_added_mass": np.log(6.0),
        "link_mass.wrist": np.log(1.5),
    }
    varied = apply_variation(config, SET, Variation(deviations=tuple(deviation.values())))
    old, new = (build_vehicle(made, SET, 16.0) for made in (config, varied))
    close = {"rtol": 1e-5}
    np.testing.assert_allclose(new.volume_m3, old.volume_m3 + 1e-4, **close)
    np.testing.assert_allclose(new.p_cb_m - old.p_cb_m, [0.0, 0.0, 0.002], atol=1e-7)
    np.testing.assert_allclose(np.diag(new.M_A / old.M_A), [1, 1, 4, 1, 1, 1], **close)
    np.testing.assert_allclose(new.D_l / old.D_l, [1, 1, 1, 2, 1, 1], **close)
    np.testing.assert_allclose(new.D_q / old.D_q, [1, 1, 1, 1, 1, 3], **close)
    np.testing.assert_allclose(new.links.normal_area_m2, 5.0 * old.links.normal_area_m2, **close)
    np.testing.assert_allclose(new.links.added_volume, 6.0 * old.links.added_volume, **close)
    ratio = np.asarray(new.links.mass_kg / old.links.mass_kg)
    np.testing.assert_allclose(ratio, [1, 1, 1, 1, 1.5, 1], **close)
    np.testing.assert_array_equal(new.inertia_kgm2, old.inertia_kgm2)


def test_no_deviation_is_the_file():
    config = load_vehicle("bluerov2_heavy")
    assert apply_variation(config, SET, Variation()).find_set(SET) == config.find_set(SET)
