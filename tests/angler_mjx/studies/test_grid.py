"""Grids of edits: order of cells, order of edits, names."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.studies.grid import ChangesAxis, SettingAxis, count_cells, iterate_cells

WATER = ChangesAxis(
    key="water",
    names=("still", "moving"),
    values=({"time": {"horizon_s": 5.0}}, {"world": {"currents": [1.0]}}),
)
HORIZON = SettingAxis(key="time.horizon_s", names=("7", "8"), values=(7, 8))
BASE = {"time": {"horizon_s": 1.0, "record_hz": 2.0}, "world": {"seed": 3}}


def test_the_last_axis_changes_fastest() -> None:
    cells = list(iterate_cells([WATER, HORIZON]))
    assert count_cells([WATER, HORIZON]) == len(cells) == 4
    assert [cell.label for cell in cells] == ["still, 7", "still, 8", "moving, 7", "moving, 8"]
    assert cells[3].number == 3
    assert cells[3].names == {"water": "moving", "time.horizon_s": "8"}
    assert cells[3].values["time.horizon_s"] == 8


def test_a_later_axis_edits_after_an_earlier_one_and_the_base_stays() -> None:
    first_then_set, set_then_merged = (
        next(iterate_cells(axes)).edit(BASE) for axes in ([WATER, HORIZON], [HORIZON, WATER])
    )
    assert first_then_set["time"] == {"horizon_s": 7, "record_hz": 2.0}
    assert set_then_merged["time"] == {"horizon_s": 5.0, "record_hz": 2.0}
    assert BASE["time"] == {"horizon_s": 1.0, "record_hz": 2.0}


def test_no_axes_make_one_cell_without_a_label() -> None:
    (cell,) = iterate_cells([])
    assert cell.label == ""
    assert cell.edit(BASE) == BASE


def test_a_key_that_leads_nowhere_is_refused_when_its_cell_is_edited() -> None:
    (cell,) = iterate_cells([SettingAxis(key="world.seed.x", names=("1",), values=(1,))])
    with pytest.raises(ConfigError, match=r"world\.seed"):
        cell.edit(BASE)
