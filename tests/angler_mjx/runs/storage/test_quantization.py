"""Arrays in steps: Zarr itself, with its own codecs, reads what was written, and writes it so."""

import numpy as np
import pytest
import zarr

from angler_mjx.learning.datasets.stored import StoredArray
from angler_mjx.runs.storage import shards, trajectory_layout
from angler_mjx.runs.storage.quantization import build_quantization
from angler_mjx.runs.storage.recorder import TrajectoryShape
from angler_mjx.scenario.store_table import StoreConfig

STORE = StoreConfig(
    position_mm=1.0, velocity_mmps=2.0, attitude_mrad=2.0, force_mn=10.0, pwm_us=1.0
)


def described(path, steps, shape):
    return zarr.create_array(
        path,
        shape=shape,
        chunks=(1, *shape[1:]),
        shards=shape,
        dtype="float32",
        fill_value=np.nan,
        filters=steps.filters(len(shape)),
        compressors=steps.compressor(),
    )


@pytest.mark.parametrize(("step", "unit"), [(1e-3, "m"), (1e-3, "m/s"), (1e-3, "1"), (1.0, "us")])
def test_zarr_reads_what_is_written_to_half_a_step(tmp_path, step, unit):
    rng = np.random.default_rng(0)
    values = rng.uniform(-1, 1, size=(3, 7, 2, 3)).astype(np.float32)
    values[1, 4:] = np.nan
    steps = build_quantization(step, unit)
    array = described(tmp_path / "a.zarr", steps, values.shape)
    shards.write_shard(
        tmp_path / "a.zarr" / "c" / "0" / "0" / "0" / "0", [steps.encode_worlds(values)], shard=3
    )
    read = array[:]
    assert np.array_equal(np.isnan(read), np.isnan(values))
    known = np.isfinite(values)
    assert np.abs(read - values)[known].max() <= 0.5 * step * (1 + 1e-5)
    # Zarr's own writer makes the same numbers of them.
    other = described(tmp_path / "b.zarr", steps, values.shape)
    other[:] = values
    assert np.array_equal(other[:], read, equal_nan=True)


def test_what_is_out_of_range_is_clamped_and_inf_stays_where_there_is_room(tmp_path):
    values = np.array([[[1e12], [-1e12], [np.inf], [0.0]]], np.float32)
    for step, unit, most, endless in (
        (1e-3, "m", 2147483.0, np.inf),
        (1e-3, "m/s", 32.767, 32.767),
    ):
        steps = build_quantization(step, unit)
        path = tmp_path / f"{unit[-1]}.zarr"
        array = described(path, steps, values.shape)
        shards.write_shard(path / "c" / "0" / "0" / "0", [steps.encode_worlds(values)], shard=1)
        np.testing.assert_allclose(array[0, :, 0], [most, -most, endless, 0.0], rtol=1e-3)
        np.testing.assert_array_equal(array[0], StoredArray(path).read(0))
        np.testing.assert_array_equal(steps.round_values(values)[0], array[0])


def test_samples_are_stepped_by_their_units_and_nothing_else_is():
    shape = TrajectoryShape(
        worlds=2, samples=5, robots=2, thrusters=8, obstacles=3, plan_points=4, store_config=STORE
    )
    found = {name: shape.stepped(name) for name in trajectory_layout.ARRAYS}
    per_unit = {name: steps.per_unit for name, steps in found.items() if steps}
    assert per_unit["p_m"] == per_unit["target_m"] == per_unit["obstacle_p_m"] == 1000.0
    assert per_unit["nu"] == per_unit["current_mps"] == 500.0
    assert per_unit["q"] == per_unit["obstacle_q"] == 1000.0
    assert per_unit["pwm_us"] == 1.0
    assert not any(found[name] for name in ("outcome", "plan_m", "end/p_m"))
    exact = TrajectoryShape(worlds=2, samples=5, robots=2, thrusters=8, obstacles=3, plan_points=4)
    assert not any(exact.stepped(name) for name in trajectory_layout.ARRAYS)
