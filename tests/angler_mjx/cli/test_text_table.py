"""Tables on narrow terminals: every character of every cell is there."""

import io

import pytest
from rich.console import Console

from angler_mjx.cli.shared.text_table import build_text_table
from angler_mjx.testing.referee import QUANTITIES


def printed(made, width):
    """What a terminal of some width shows, column by column, without the frame."""
    console = Console(width=width, file=io.StringIO(), color_system=None)
    console.print(made)
    lines = console.file.getvalue().splitlines()
    assert max(map(len, lines)) <= width
    cells = [line.split("\u2502")[1:-1] for line in lines if line.startswith("\u2502")]
    return ["".join(part.strip() for part in column) for column in zip(*cells, strict=True)]


@pytest.mark.parametrize("width", [60, 80])
def test_names_of_rows_stay_whole_beside_many_columns(width):
    headings = ("exact", "bounded", "not checked", "undecided", "disagree", "largest deviation")
    made = build_text_table("quantity", *headings)
    for name in QUANTITIES:
        made.add_row(name, "1024", "0", "0", "0", "0", "1.2e-06 of it")
    console = Console(width=width, file=io.StringIO(), color_system=None)
    console.print(made)
    shown = console.file.getvalue()
    assert all(f" {name} " in shown for name in QUANTITIES)


@pytest.mark.parametrize("fixed", [0, 1])
def test_nothing_is_cut_off_at_40_columns(fixed):
    made = build_text_table("planner", "arrived", "reason", fixed=fixed)
    texts = ("straight.py:Straight", "12.5 (3.1 to 38.5)", "KeyError_start_in_a_file_of_the_user")
    made.add_row(*texts)
    # Lines break at spaces where there are any.
    bare = ["".join(text.split()) for text in texts]
    assert ["".join(column.split()) for column in printed(made, 40)] == bare
