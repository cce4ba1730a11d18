"""Rows of episodes that were written by older versions."""

import pyarrow as pa
import pytest

from angler_mjx.runs.storage.episode_columns import EPISODE_SCHEMA
from angler_mjx.runs.storage.results import check_table

OF_TEXT = {"outcome": "reached", "vehicle": "a", "parameter_set": "b", "failure_pair": "none"}


def rows(last):
    """Two rows, with a value in each column up to the last of them."""
    kinds = {pa.string(): "x", pa.bool_(): True}
    names = EPISODE_SCHEMA.names[: EPISODE_SCHEMA.names.index(last) + 1]
    row = {name: kinds.get(EPISODE_SCHEMA.field(name).type, 1) for name in names} | OF_TEXT
    schema = pa.schema([EPISODE_SCHEMA.field(name) for name in names])
    return pa.Table.from_pylist([row, row], schema)


@pytest.mark.parametrize("last", ["redraws", "late_s", "failed_replans"])
def test_columns_that_older_runs_lack_are_empty(last):
    table = rows(last)
    found = check_table(table)
    assert found.schema.equals(EPISODE_SCHEMA)
    for name in EPISODE_SCHEMA.names:
        known = name in table.column_names
        assert found[name].null_count == (0 if known else 2), name


def test_columns_of_no_version_are_refused():
    with pytest.raises(ValueError, match="holds the columns"):
        check_table(rows("plan_reason"))
