"""States and samples of an engine as a run folder, without a run."""

import json

import jax
import numpy as np
import pyarrow.parquet as pq

from angler_mjx.runs.storage import device_to_host, results
from angler_mjx.runs.storage.device_to_host import FinishedTile
from angler_mjx.runs.storage.recorder import Recorder, TrajectoryShape
from angler_mjx.sim import fleet


def store(path, scene, members, after, samples):
    """Write a folder of all worlds of a scene.

    Args:
        path: to make.
        scene: that was played.
        members: its robots.
        after: state at the end.
        samples: of every control step; [steps, W] lead.
    """
    samples = jax.tree.map(lambda leaf: np.moveaxis(np.asarray(leaf), 0, 1), samples)
    tile = FinishedTile(
        first=0,
        kept=samples.p.shape[0],
        constants=jax.tree.map(
            np.asarray, device_to_host.select_constants(scene.worlds, recorded=True)
        ),
        end=jax.tree.map(np.asarray, device_to_host.select_end(after, recorded=True)),
        parts=[samples],
    )
    worlds, steps, robots = samples.p.shape[:3]
    dt = scene.spec.control_dt_s
    path.mkdir()
    shape = TrajectoryShape(
        worlds=worlds,
        samples=steps,
        robots=robots,
        thrusters=samples.pwm_us.shape[-1],
        obstacles=samples.obstacle_p.shape[2],
        plan_points=tile.constants.plan["plan_time_s"].shape[-1],
        jointed="plan_degree" in tile.constants.plan,
    )
    environment = tile.constants.environment
    place = path / "trajectories.zarr"
    recorder = Recorder.create(place, shape, environment, tile=worlds, sample_dt_s=dt)
    recorder.write(0, device_to_host.recorded_arrays(tile, steps), environment)
    kinds = [(kind.vehicle, kind.parameter_set) for kind in fleet.list_variants(members)]
    rows = results.episode_table(device_to_host.build_tile_result(tile), kinds, 0)
    pq.write_table(rows, path / "episodes.parquet")
    entries = [
        {
            "vehicle": member.variants[0].vehicle,
            "count": 1,
            "battery_v": member.variants[0].battery_v,
            "parameter_mix": {variant.parameter_set: 1.0 for variant in member.variants},
        }
        for member in members
    ]
    timing = {"record_hz": 1.0 / dt, "control_dt_s": dt, "horizon_s": steps * dt}
    config = {
        "time": timing,
        "fleet": entries,
        "goal_tolerance_m": scene.spec.goal_tolerance_m,
        "worlds": worlds,
    }
    (path / "config.json").write_text(json.dumps(config))
    summary = {"worlds_done": worlds, "tile": worlds}
    (path / "summary.json").write_text(json.dumps(summary))
    return path
