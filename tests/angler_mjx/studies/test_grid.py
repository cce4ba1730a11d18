"""Grids of edits: order of cells, order of edits, names."""

import pytest

from angler_mjx.errors import ConfigError
from angler_mjx.studies.grid import (
    ChangesAxis,
    SettingAxis,
    build_changes_axis,
    count_cells,
    find_reserved_key,
    iterate_cells,
)

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


def test_an_axis_of_changes_holds_them_by_name() -> None:
    changes = dict(zip(WATER.names, WATER.values, strict=True))
    assert build_changes_axis("water", changes) == WATER


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({"seed": 1}, "seed: give seeds instead"),
        ({"planner": {"name": "grid"}, "seed": 1}, "planner.name: give [[planner]] instead"),
        ({"planner": {"margin_m": 1.0}, "planner.name": "grid"}, None),
        ({"planner": 3}, None),
    ],
)
def test_a_reserved_key_is_found_with_its_replacement(changes, fault) -> None:
    reserved = {"planner.name": "[[planner]]", "seed": "seeds"}
    assert find_reserved_key(changes, reserved) == fault
