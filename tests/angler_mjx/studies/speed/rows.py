"""Rows made by hand, for all that is done with rows once they are measured."""

import json
from dataclasses import asdict

from angler_mjx.studies.speed.rows import SpeedRow


def make_row(**changes):
    known = {
        "workload": "reef_fleet",
        "inside": "everything",
        "worlds": 64,
        "robots": 4,
        "unit": "vehicle-steps/s",
        "median": 1.0e6,
        "low": 0.9e6,
        "high": 1.1e6,
        "repeats": 10,
        "compile_s": 12.0,
        "engine": "fused",
        "kernels": "xla",
        "flops": 4000.0,
        "flops_from": "loops as often as they run",
        "least_bytes": 30.0,
    }
    return SpeedRow(**(known | changes))


def write_rows(path, rows, **around):
    limits = {"copy_bytes_per_s": 1e9, "fma_flops_per_s": 8e10}
    around = {"device": "cpu", "commit": None, "driver": None, **limits} | around
    with path.open("a") as file:
        for row in rows:
            file.write(json.dumps({**asdict(row), **around}) + "\n")
    return path
