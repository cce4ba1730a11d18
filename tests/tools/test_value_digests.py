"""Digests of values: equal for equal values, and what differs is named."""

import json
import shlex

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import zarr

from angler_mjx.cli import main as cli
from tools.value_digests import __main__ as tool


@pytest.mark.parametrize("name", sorted(tool.list_items()))
def test_every_line_begins_with_a_command_and_writes_into_out(name):
    words = shlex.split(tool.list_items()[name])
    names = ("COMMANDS", "GROUPS")
    assert words[0] in {key for table in names for key in getattr(cli, table, {})}
    assert words[-2:] == ["--out", "out"]


def _folder(path, values, text="a", seconds=1.0):
    group = zarr.create_group(path / "run" / "values.zarr")
    group.create_array("p_m", data=np.asarray(values))
    rows = pa.table({"outcome": [text, None], "x": [1.0, 2.0], "planning_s": [seconds, seconds]})
    pq.write_table(rows, path / "run" / "rows.parquet")
    return dict(tool.iterate_digests(path / "run"))


def test_equal_values_have_equal_digests_whatever_the_clock_said(tmp_path):
    first = _folder(tmp_path / "a", [1.0, 2.0], seconds=1.0)
    again = _folder(tmp_path / "b", [1.0, 2.0], seconds=9.0)
    assert first == again
    assert sorted(first) == [
        "run/rows.parquet:outcome",
        "run/rows.parquet:x",
        "run/values.zarr:p_m",
    ]


def test_a_value_a_type_a_shape_and_a_text_change_their_digest_alone(tmp_path):
    first = _folder(tmp_path / "a", [1.0, 2.0])
    for i, values in enumerate(([1.0, 2.0 + 1e-15], np.float32([1.0, 2.0]), [[1.0, 2.0]])):
        other = _folder(tmp_path / f"b{i}", values)
        assert {name for name in first if first[name] != other[name]} == {"run/values.zarr:p_m"}
    other = _folder(tmp_path / "c", [1.0, 2.0], text="b")
    assert {name for name in first if first[name] != other[name]} == {"run/rows.parquet:outcome"}


@pytest.mark.parametrize(
    ("after", "code", "words"),
    [
        ({"run": {"out/a:x": "1", "out/a:y": "2"}}, 0, "0 items differ"),
        ({"run": {"out/a:x": "1", "out/a:y": "3"}}, 1, "run: differs: out/a:y"),
        ({"run": {"out/a:x": "1"}}, 1, "run: missing: out/a:y"),
        ({"run": {"out/a:x": "1", "out/a:y": "2", "out/a:z": "0"}}, 0, "run: new: out/a:z"),
        ({}, 1, "run: missing"),
    ],
)
def test_what_differs_is_named(tmp_path, capsys, after, code, words):
    before = tmp_path / "before.json"
    before.write_text(json.dumps({"run": {"out/a:w": "1", "out/a:y": "2"}}))
    later, names = tmp_path / "after.json", tmp_path / "names.json"
    later.write_text(json.dumps(after))
    names.write_text(json.dumps({"w": "x"}))
    assert (
        tool.compare_digests(tool.CompareOptions(before=before, after=later, renamed=names)) == code
    )
    assert words in capsys.readouterr().out
