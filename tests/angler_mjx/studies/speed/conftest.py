import json

import pytest

from .rows import make_row, write_rows


@pytest.fixture
def rows_file(tmp_path):
    """Two commits, two devices, one of the first version's lines, one row without a number."""
    path = tmp_path / "rows.jsonl"
    old = {
        "workload": "mjx/reef_fleet/simulation",
        "inside": "all",
        "worlds": 64,
        "robots": 4,
        "unit": "vehicle-steps/s",
        "median": 2.0e5,
        "low": 1.9e5,
        "high": 2.2e5,
        "repeats": 10,
        "compile_s": 9.0,
        "device": "cpu",
        "commit": "0aa",
    }
    path.write_text(json.dumps(old) + "\n")
    sizes = [make_row(worlds=n, median=n * 2e4, low=n * 1.9e4, high=n * 2.2e4) for n in (1, 16, 64)]
    write_rows(path, sizes, commit="abc1")
    faster = [
        make_row(worlds=1, median=6e4, low=5.7e4, high=6.6e4),
        make_row(worlds=16, median=3.3e5, low=3.0e5, high=3.6e5),
    ]
    write_rows(path, faster, commit="def2")
    big = [make_row(worlds=n, median=n * 1e6, low=n * 0.99e6, high=n * 1.01e6) for n in (16, 4096)]
    write_rows(path, big, device="NVIDIA H200", commit="def2", fma_flops_per_s=6e13)
    none = {name: None for name in ("median", "low", "high", "compile_s")}
    refused = make_row(worlds=65536, **none, refused="out of device memory", out_of_memory=True)
    return write_rows(path, [refused], commit="def2")
