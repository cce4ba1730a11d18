"""Fly a scenario and read its results: a table of episodes, trajectories, a summary.

A run folder is never overwritten: delete it, or choose another name.
"""

from pathlib import Path

import numpy as np

import angler_mjx as angler


def main(out: Path = Path("runs/example")) -> angler.Run:
    """Fly 8 worlds of four robots; print how their episodes ended."""
    scenario = angler.load_scenario("open_water_current", worlds=8, time={"horizon_s": 60.0})
    run = angler.rollout(scenario, out=out)

    for outcome, row in run.summary["outcomes"].items():
        if row["count"]:
            print(f"{outcome}: {row['count']} robots, {row['low']:.0%} to {row['high']:.0%}")

    length_m = run.episodes["path_length_m"].to_numpy()  # a row of each robot, of pyarrow
    print(f"{len(length_m)} robots swam {np.nansum(length_m):.0f} m")

    position_m = run.trajectories["p_m"]  # Zarr: world, sample, robot, x y z
    print(f"robot 0 of world 0 starts at {position_m[0, 0, 0]} m")
    return run


if __name__ == "__main__":
    main()
