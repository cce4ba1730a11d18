"""``croissant.json`` judged by MLCommons' own library."""

import json

import pytest

from angler_mjx.learning import datasets


@pytest.fixture(scope="module")
def read(made):
    mlcroissant = pytest.importorskip("mlcroissant", reason="needs mlcroissant, of the extra dev")
    return mlcroissant.Dataset(jsonld=made / "croissant.json")


def test_the_file_has_neither_errors_nor_warnings(read):
    issues = read.metadata.ctx.issues
    assert (list(issues.errors), list(issues.warnings)) == ([], [])


def test_the_library_would_write_the_same_file(read, made):
    assert read.metadata.to_json() == json.loads((made / "croissant.json").read_text())


def test_its_records_are_the_rows_of_the_index(read, made):
    rows = datasets.open(made).index.to_pylist()
    records = list(read.records("episodes"))
    assert [record["episodes/episode"] for record in records] == [row["episode"] for row in rows]
    assert {key.partition("/")[2] for key in records[0]} == set(rows[0])
