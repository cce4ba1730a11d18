"""Speeds in README and docs are those of the rows they name, in benchmarks/results.jsonl."""

import re
from pathlib import Path

import pytest

from angler_mjx.speed import chart
from angler_mjx.speed import rows as speed
from angler_mjx.speed.compare import latest

ROOT = Path(__file__).parent.parent
RESULTS = ROOT / "benchmarks" / "results.jsonl"

REEF = {"workload": "reef_fleet", "worlds": 16384, "robots": 4, "devices": 1}
EIGHT = {"workload": "closed_loop_8", "worlds": 65536, "robots": 8, "devices": 1}
CLAIMS = {
    "README, the table: mjx": (
        "README.md",
        r"while all move, (\S+) vehicle-steps/s with everything on",
        {**REEF, "engine": "mjx"},
    ),
    "README, engines: fused": (
        "README.md",
        r"the demo's scenario runs at (\S+) vehicle-steps/s in 16,384 worlds",
        {**REEF, "engine": "fused"},
    ),
    "README, engines: mjx": (
        "README.md",
        r"where mjx makes (\S+), and eight robots",
        {**REEF, "engine": "mjx"},
    ),
    "README, engines: eight of a kind": (
        "README.md",
        r"eight robots of one kind at (\S+);",
        {**EIGHT, "engine": "fused"},
    ),
    "decision 3: mjx": (
        "docs/decisions/0003-mjx-engine.md",
        r"\*\*Measured\.\*\* (\S+) vehicle-steps/s on one H200 at 16,384 worlds",
        {**REEF, "engine": "mjx"},
    ),
}
"""Where a rate stands, and which row it is of: the latest of an H200 with these fields."""


@pytest.fixture(scope="module")
def rows():
    return latest(speed.read(RESULTS))


@pytest.mark.parametrize("claim", CLAIMS)
def test_a_rate_is_that_of_its_row(rows, claim):
    file, pattern, wanted = CLAIMS[claim]
    found = re.findall(pattern, (ROOT / file).read_text())
    assert len(found) == 1, f"{file}: {pattern!r} is there {len(found)} times"
    wanted = {**wanted, "device": "NVIDIA H200"}
    mine = [row for row in rows if all(row[key] == value for key, value in wanted.items())]
    assert mine, f"no row of {wanted}"
    row = mine[-1]
    said = f"{file} says {found[0]}, the row of commit {row['commit']}: {row['median']:.3g}"
    assert found[0] == chart.short(row["median"]), said


def test_several_devices_scale_as_said(rows):
    """Four H200 do four times what one does."""
    text = (ROOT / "README.md").read_text()
    assert "four H200 do four times that" in text
    rate = {
        row["devices"]: row["median"]
        for row in rows
        if row["workload"] == "closed_loop_8"
        and (row["worlds"], row["robots"], row["device"]) == (65536, 8, "NVIDIA H200")
    }
    assert rate[4] / rate[1] == pytest.approx(4, rel=0.05)


def test_the_table_of_performance_is_that_of_the_rows():
    text = (ROOT / "docs" / "performance.md").read_text()
    between = text.partition(chart.BEGIN)[2].partition(chart.END)[0]
    assert between.strip() == chart.table(RESULTS), (
        "write it again: angler bench --table benchmarks/results.jsonl --out docs/performance.md"
    )
