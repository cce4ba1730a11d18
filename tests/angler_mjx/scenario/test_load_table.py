"""What goods weigh: refusals, and what is left out."""

import numpy as np
import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.scenario.scenario import load_scenario


def carried(**table):
    task = {"type": "deliver", "goods": 2, "load": {"mass_kg": 2.0, "volume_m3": 0.001, **table}}
    return load_scenario("reef_fleet", task=task, water={"density_kgpm3": 1025.0}).carried()


def test_what_is_left_out_is_that_of_a_sphere():
    """A litre: a radius of 62 mm, 121 cm2, and half a litre of sea water moves with it."""
    load = carried()
    np.testing.assert_allclose(load.drag_area_m2, 0.47 * 0.012090, rtol=1e-3)
    np.testing.assert_allclose(load.added_mass_kg, 0.5125, rtol=1e-12)
    given = carried(drag_area_m2=[0.0, 0.1, 0.2], added_mass_kg=[0.0, 1.0, 2.0])
    assert (given.drag_area_m2, given.added_mass_kg) == ((0.0, 0.1, 0.2), (0.0, 1.0, 2.0))


def test_goods_that_nobody_feels_change_no_fleet():
    assert load_scenario("reef_fleet").carried() is None
    assert load_scenario("reef_fleet", task={"type": "deliver"}).carried() is None


@pytest.mark.parametrize(
    ("table", "said"),
    [
        ({"mass_kg": 60.0}, ["task.load", "60 kg", "fleet[0]", "sinks", "in heave", "lighter"]),
        ({"volume_m3": 0.2}, ["task.load", "0.2 m3", "rises", "in heave"]),
        ({"mass_kg": 0.0}, ["task", "load.mass_kg", "greater than 0"]),
        ({"drag_area_m2": [0.1, -0.1, 0.1]}, ["load.drag_area_m2", "0"]),
    ],
)
def test_what_cannot_be_is_refused(table, said):
    with pytest.raises(ConfigError) as error:
        carried(**table)
    for words in said:
        assert words in str(error.value)
