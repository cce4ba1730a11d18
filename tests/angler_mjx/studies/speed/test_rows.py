import json
import math
from dataclasses import asdict, replace
from pathlib import Path

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.studies.speed import chart
from angler_mjx.studies.speed import rows as speed
from angler_mjx.studies.speed.chart import with_bounds
from angler_mjx.studies.speed.compare import compare_rows, select_latest
from angler_mjx.studies.speed.roofline import (
    DeviceSpeed,
    compare_with_bound,
    compute_bound,
    describe_conditions,
)

from .rows import make_row, write_rows

DEVICE = DeviceSpeed(copy_bytes_per_s=1e9, fma_flops_per_s=1e11, driver=None)


def test_what_is_recorded_is_read_again(tmp_path):
    path = tmp_path / "deep" / "rows.jsonl"
    row = make_row()
    speed.append_row(row, {**describe_conditions(DEVICE), **compare_with_bound(row, DEVICE)}, path)
    (found,) = speed.read_rows(path)
    assert {name: found[name] for name in asdict(row)} == asdict(row)
    for name in ("device", "versions", "commit", "driver", "copy_bytes_per_s", "fma_flops_per_s"):
        assert name in found


def test_a_row_that_is_not_a_number_is_not_written(tmp_path):
    path = tmp_path / "rows.jsonl"
    with pytest.raises(ValueError):
        speed.append_row(make_row(median=math.nan), {}, path)
    assert path.read_text() == ""


def test_rows_of_the_first_version_are_read(rows_file):
    first = speed.read_rows(rows_file)[0]
    assert (first["workload"], first["engine"], first["kernels"]) == ("reef_fleet", "mjx", "xla")
    assert first["flops"] is None


def test_the_rows_of_the_repository_are_read():
    path = Path(__file__).parents[4] / "benchmarks" / "results.jsonl"
    rows = speed.read_rows(path)
    assert len(rows) == len(path.read_text().splitlines())
    assert all(row["engine"] for row in rows if row["unit"] == "vehicle-steps/s")


@pytest.mark.parametrize("line", ["{", "[]", '"text"', '{"worlds": 1}', '{"workload": 3}'])
def test_a_line_that_is_no_row_is_named(tmp_path, line):
    path = tmp_path / "rows.jsonl"
    path.write_text(f"\n{line}\n")
    with pytest.raises(ConfigError, match="line 2"):
        speed.read_rows(path)


def test_the_lower_of_two_limits_is_the_roofline():
    # 1e11 flops/s over 4,000 each, 1e9 bytes/s over 30 each.
    assert compute_bound(make_row(), DEVICE) == pytest.approx(1e11 / 4000)
    assert compute_bound(make_row(flops=None), DEVICE) == pytest.approx(1e9 / 30)
    assert compute_bound(make_row(devices=4), DEVICE) == pytest.approx(4e11 / 4000)
    assert compute_bound(make_row(flops=None, least_bytes=None), DEVICE) is None
    assert compare_with_bound(make_row(median=5e6), DEVICE)["share_of_bound"] == pytest.approx(0.2)


def test_commits_in_one_file_are_compared_size_by_size(rows_file):
    ratios = {row.worlds: row for row in compare_rows("abc", "def", rows_file).ratios}
    assert sorted(ratios) == [1, 16]
    assert ratios[1].ratio == pytest.approx(3.0)
    assert (ratios[1].low, ratios[1].high) == pytest.approx((5.7e4 / 2.2e4, 6.6e4 / 1.9e4))
    assert ratios[1].beyond_spread
    # 3.0e5 to 3.6e5 against 3.04e5 to 3.52e5: the repeats overlap.
    assert not ratios[16].beyond_spread


def test_files_of_two_machines_are_compared(tmp_path, rows_file):
    a = write_rows(tmp_path / "a.jsonl", [make_row()], device="cpu")
    b = write_rows(
        tmp_path / "b.jsonl", [make_row(median=4e6, low=3.6e6, high=4.4e6)], device="NVIDIA H200"
    )
    found = compare_rows(str(a), str(b), rows_file)
    (row,) = found.ratios
    assert row.ratio == pytest.approx(4.0)
    assert "NVIDIA H200" in found.machines
    assert not compare_rows(str(a), str(a), rows_file).machines


HOST = {"processor": "Model A", "cpu_count": 2}
OTHERS = [{**HOST, "processor": "Model B"}, {**HOST, "cpu_count": 16}]


def seconds_row(seconds, name="compile/reef_fleet", **changes):
    three = dict.fromkeys(("median", "low", "high"), seconds)
    return make_row(workload=name, unit="s", repeats=1, **three, **changes)


def test_fewer_seconds_are_faster_and_one_repeat_has_no_spread(tmp_path):
    a = write_rows(tmp_path / "a.jsonl", [seconds_row(60.0)], **HOST)
    b = write_rows(tmp_path / "b.jsonl", [seconds_row(20.0)], **HOST)
    found = compare_rows(str(a), str(b), tmp_path / "none")
    (row,) = found.ratios
    assert (row.ratio, row.low, row.high) == pytest.approx((3.0, 3.0, 3.0))
    assert row.repeats == 1
    assert found.left_out == []


@pytest.mark.parametrize("other", OTHERS)
def test_seconds_of_another_host_are_left_out_by_name(tmp_path, other):
    segment = "compile/reef_fleet/segment"
    rows = [seconds_row(60.0), seconds_row(30.0, segment)]
    a = write_rows(tmp_path / "a.jsonl", rows, **HOST)
    b = write_rows(tmp_path / "b.jsonl", [seconds_row(50.0)], **HOST)
    write_rows(b, [seconds_row(20.0, segment), seconds_row(1.0, "compile/open")], **other)
    found = compare_rows(str(a), str(b), tmp_path / "none")
    assert [(row.workload, row.ratio) for row in found.ratios] == [("compile/reef_fleet", 1.2)]
    ours, theirs, new = found.left_out
    host = f"{other['processor']}, {other['cpu_count']} cores"
    assert ours == (
        f"{segment} fused/xla, 64 x 4 in {a}: measured on Model A, 2 cores, in {b} on {host}"
    )
    assert f"in {b}: measured on {host}, in {a} on Model A, 2 cores" in theirs
    assert new.endswith(f"{a} has no such row")
    with pytest.raises(ConfigError, match=f"measured on Model A, 2 cores, in .* on {host}"):
        compare_rows(
            str(a), str(write_rows(tmp_path / "c.jsonl", rows, **other)), tmp_path / "none"
        )


def test_rates_of_processors_are_kept_apart_where_a_side_has_several(tmp_path):
    """The last row of a commit may be of a host that the other commit was not measured on."""
    a = write_rows(tmp_path / "a.jsonl", [make_row()], **HOST)
    b = write_rows(tmp_path / "b.jsonl", [make_row()], **HOST)
    write_rows(b, [make_row(median=4e6, low=3.6e6, high=4.4e6)], **OTHERS[1])
    found = compare_rows(str(a), str(b), tmp_path / "none")
    assert [row.ratio for row in found.ratios] == [1.0]
    (left_out,) = found.left_out
    assert "measured on Model A, 16 cores" in left_out


def test_seconds_stand_in_a_table_of_their_own(tmp_path):
    rows = [
        seconds_row(seconds, "/".join(("compile/reef_fleet", *rest)))
        for seconds, *rest in (
            (60.04,),
            (30.0, "segment"),
            (9.0, "cached"),
            (4.0, "segment", "cached"),
        )
    ]
    path = write_rows(tmp_path / "rows.jsonl", rows, versions={"jax": "1.2"}, **HOST)
    write_rows(path, [seconds_row(7.0)], **OTHERS[0])
    assert "compile" not in chart.format_table(path).partition("\n")[2]
    _, _, first, second = chart.compile_table(path).splitlines()
    assert "| reef_fleet | fused/xla | CPU | Model A, 2 cores | 64 x 4 |" in first
    assert "| -; - | -; - | 30.0; 4.0 | 60.0; 9.0 | 1.2 |" in first
    assert "| Model B, 2 cores |" in second
    document = tmp_path / "doc.md"
    document.write_text(f"{chart.BEGIN}\n{chart.END}\n")
    with pytest.raises(ConfigError, match="compiled: begin"):
        chart.write_table(path, document)
    assert "reef_fleet" not in document.read_text()
    document.write_text("\n".join((chart.BEGIN, chart.END, *chart.COMPILED)))
    chart.write_table(path, document)
    assert first in document.read_text()
    write_rows(path, [make_row()])
    assert compare_rows(str(path), str(path), path).left_out == []


def test_a_later_row_takes_the_place_of_an_earlier(tmp_path):
    path = write_rows(tmp_path / "a.jsonl", [make_row(median=1.0e6), make_row(median=1.05e6)])
    assert [row["median"] for row in select_latest(speed.read_rows(path))] == [1.05e6]


def test_comparing_with_nothing_says_so(tmp_path, rows_file):
    with pytest.raises(ConfigError, match="no row of"):
        compare_rows("abc", "fff", rows_file)
    other = write_rows(tmp_path / "b.jsonl", [make_row(worlds=7)])
    with pytest.raises(ConfigError, match="same engine and size"):
        compare_rows("abc", str(other), rows_file)


def test_the_chart_has_a_line_for_each_device_and_engine(rows_file):
    figure = chart.plot_rows(rows_file)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert sum("fused/xla, CPU" in label for label in labels) == 1
    assert sum("fused/xla, H200" in label for label in labels) == 1
    assert sum("mjx, CPU" in label for label in labels) == 1
    (axes,) = figure.axes
    assert {text.get_text() for text in axes.texts} == {
        "roofline: reef_fleet, CPU",
        "roofline: reef_fleet, H200",
    }
    assert (axes.get_xscale(), axes.get_yscale()) == ("log", "log")


def test_a_chart_of_no_simulation_is_refused(tmp_path):
    path = write_rows(tmp_path / "a.jsonl", [make_row(unit="worlds/s")])
    with pytest.raises(ConfigError, match="vehicle-steps/s"):
        chart.plot_rows(path)


def test_the_table_takes_its_place_in_a_document(tmp_path, rows_file):
    document = tmp_path / "doc.md"
    document.write_text(f"above\n{chart.BEGIN}\nold\n{chart.END}\nbelow\n")
    chart.write_table(rows_file, document)
    text = document.read_text()
    assert text.startswith("above\n")
    assert text.endswith("\nbelow\n")
    assert "old" not in text
    # The later commit's row of 16 worlds; the row without a number is left out.
    assert "| reef_fleet | fused/xla | CPU | 16 x 4 | 3.3e5 vehicle-steps/s | 18 % |" in text
    assert "65,536" not in text
    chart.write_table(rows_file, document)
    assert document.read_text() == text


def test_bounds_of_many_days_are_of_one_definition(tmp_path):
    """The greatest limits of a device, and operations counted as they are now, or no bound."""
    path = tmp_path / "rows.jsonl"
    old = "at least: loops that run until something happens count once"
    write_rows(path, [make_row(flops_from=old)], device="A", fma_flops_per_s=2e10)
    write_rows(path, [make_row(), make_row(devices=2)], device="A", fma_flops_per_s=4e10)
    write_rows(path, [make_row()], device="A", fma_flops_per_s=3e10)
    write_rows(path, [make_row(flops_from=f"{old}, branches as the cheapest")], device="B")
    write_rows(path, [make_row()], device="C", copy_bytes_per_s=None, fma_flops_per_s=None)
    bounds = [row["bound"] for row in with_bounds(speed.read_rows(path))]
    assert bounds == [None, 1e7, 2e7, 1e7, 2e7, None]


def test_a_processor_is_known_by_its_cores(tmp_path):
    path = write_rows(tmp_path / "rows.jsonl", [make_row()], cpu_count=2)
    write_rows(path, [make_row()], cpu_count=64, copy_bytes_per_s=1e11, fma_flops_per_s=4e12)
    assert [row["bound"] for row in with_bounds(speed.read_rows(path))] == [2e7, 1e9]


def test_a_document_without_a_place_is_left_alone(tmp_path, rows_file):
    document = tmp_path / "doc.md"
    document.write_text("nothing here\n")
    with pytest.raises(ConfigError, match="no place"):
        chart.write_table(rows_file, document)
    assert document.read_text() == "nothing here\n"


def test_lines_are_strict_json(tmp_path):
    path = tmp_path / "rows.jsonl"
    speed.append_row(replace(make_row(), flops=None), {}, path)

    def refuse(name):
        raise AssertionError(name)

    assert json.loads(path.read_text(), parse_constant=refuse)["flops"] is None
