"""The study of drift: our current and an independent interpolation give one track."""

import numpy as np
import pytest

from angler_experiments.ocean import drift, headland


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    return drift.run_study(tmp_path_factory.mktemp("drift"), 6)


def test_a_day_of_drift_ends_where_scipys_does(found):
    """Found are 0.1 m, of paths of 13 km: what steps of 300 s leave where they cross knots."""
    assert found["scipy"]["particles"] >= 3
    assert found["scipy"]["greatest_m"] < 0.3
    assert found["path_m"]["median"] > 5000


def test_places_are_drawn_in_water_and_flow_along_the_coast(tmp_path):
    current = drift.build_current(headland.write_dataset(tmp_path / "headland.nc"))
    begin = drift.sample_starts(current[0], 200)
    assert np.all(drift.is_in_water(current[0], begin))
    assert np.ptp(begin, axis=0).min() > 13.0
    on_land = np.array([[0.0, -3500.0, -2.0]])
    assert not drift.is_in_water(current[0], on_land)[0]


def test_no_water_crosses_the_coast_of_the_made_stream():
    """Along the straight coast and the rim of the headland the stream function is zero."""
    angle = np.linspace(0.0, np.pi, 50)
    rim = headland.RADIUS_M * np.stack([np.cos(angle), np.sin(angle)])
    for x, y in (rim, np.stack([np.linspace(2500, 9000, 50), np.zeros(50)])):
        for t in (0.0, 9000.0, 30_000.0):
            assert np.abs(headland.stream_m2ps(x, y, 2.0, t)).max() < 1e-9 * headland.RADIUS_M
