"""A submission made from the problem files by NumPy alone, as the page describes it."""

import json

import numpy as np
import zarr

from angler_mjx.leaderboard import sandbox
from angler_mjx.leaderboard.submission import ProgramConfig

CARD = """schema_version = 1
benchmark = "ANGLER-1 1.0"
name = "straight lines"
authors = ["A. Author"]
kind = "plans"
machine = "a machine"
sets = {sets}
"""


def write_card(folder, sets, **changes):
    folder.mkdir(parents=True, exist_ok=True)
    text = CARD.format(sets=json.dumps(list(sets)))
    for old, new in changes.values():
        assert old in text
        text = text.replace(old, new)
    (folder / "card.toml").write_text(text, encoding="utf-8")


def straight_lines(problems, name):
    """Return arrays of a file of plans: each robot flies straight to its goal."""
    group = zarr.open_group(problems / f"{name}.zarr", mode="r")
    start, goal = group["team/start_m"][:], group["team/goal_m"][:]
    seconds = np.linalg.norm(goal - start, axis=-1) / group["team/cruise_speed_mps"][:]
    return {
        "points": np.full(seconds.shape, 2, "i4"),
        "time_s": np.stack([0 * seconds, seconds], axis=-1).astype("f4"),
        "position_m": np.stack([start, goal], axis=2).astype("f4"),
        "planning_s": np.full(len(seconds), 0.01, "f4"),
    }, {
        "schema": "angler_mjx plans",
        "schema_version": 1,
        "digest": group.attrs["digest"],
        "seed": group.attrs["seed"],
    }


def write_plans(folder, name, arrays, attributes):
    group = zarr.open_group(folder / "plans" / f"{name}.zarr", mode="w")
    group.attrs.update(attributes)
    for key, values in arrays.items():
        group.create_array(key, data=values)


def run_command(*command, image=None, with_program=False, limit_s=20.0, **config):
    """Run a command in a sandbox with an empty problem; returns its fault."""
    with sandbox.open_scratch() as folder:
        for part in ("problem.zarr", "out", *(["program"] if with_program else [])):
            (folder / part).mkdir()
        (folder / "out").chmod(0o777)
        program = ProgramConfig(command=command, **config)
        return sandbox.run_program(sandbox.require_sandbox(), program, folder, limit_s, image)
