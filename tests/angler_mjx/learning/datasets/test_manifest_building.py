"""What a manifest states of arrays, and counts of the index."""

import numpy as np
import pyarrow as pa
import zarr

from angler_mjx.learning.datasets import manifest, manifest_building


def test_stored_values_are_multiples_of_the_step_in_the_manifest(made):
    contents = manifest.read_manifest(made)
    assert contents.arrays["p_m"].step == 1e-3
    assert contents.arrays["q"].step is None
    stored = zarr.open_group(made / contents.parts[0].path / "trajectories.zarr", mode="r")
    positions_m = np.asarray(stored["p_m"][:], float)
    steps = positions_m[np.isfinite(positions_m)] / 1e-3
    assert np.abs(steps - np.round(steps)).max() < 0.01


def test_counts_are_those_of_the_rows(made):
    table = pa.table(
        {"split": ["val", "train", "train", "test"], "chosen": [True, True, False, False]}
    )
    assert manifest_building.count_values(table, "split") == {"test": 1, "train": 2, "val": 1}
    counted = manifest_building.add_counts(manifest.read_manifest(made), table)
    assert counted.episodes == 4
    assert counted.splits == {"test": 1, "train": 2, "val": 1}
    assert counted.chosen == {"train": 1, "val": 1}
