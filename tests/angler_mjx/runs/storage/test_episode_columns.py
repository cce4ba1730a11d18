"""Declarations of the episode table."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pyarrow as pa
import pytest

from angler_mjx.runs.storage.episode_columns import (
    COMMAND,
    EPISODE_COLUMNS,
    EpisodeColumn,
    format_page,
)

PAGE = Path(__file__).parents[4] / "docs" / "generated" / "episodes.md"
RESULT = SimpleNamespace(outcome=np.zeros((2, 3), int), kept={"kept": np.array([1.0, np.nan])})


def test_each_column_is_declared_once_and_new_ones_follow():
    names = [column.name for column in EPISODE_COLUMNS]
    editions = [column.since for column in EPISODE_COLUMNS]
    assert len(set(names)) == len(names)
    assert editions == sorted(editions)
    assert all(column.nullable for column in EPISODE_COLUMNS if column.since), (
        "older tables lack it"
    )


@pytest.mark.parametrize("column", EPISODE_COLUMNS, ids=lambda column: column.name)
def test_each_column_has_one_source(column):
    assert (column.of_world is None) or (column.of_state is None)
    assert column.of_tile or column.of_world or column.of_state


def test_values_of_worlds_stand_in_each_robot_and_missing_ones_are_null():
    column = EpisodeColumn("kept", pa.float32(), "m", "", may_be_null=True)
    assert column.build(RESULT).to_pylist() == [1.0] * 3 + [None] * 3
    lacking = EpisodeColumn("lacking", pa.int32(), "1", "", may_be_null=True)
    assert lacking.build(RESULT).to_pylist() == [None] * 6


def test_the_reference_page_is_made_from_the_declarations():
    assert PAGE.read_text(encoding="utf-8") == format_page(), f"run {COMMAND}"
