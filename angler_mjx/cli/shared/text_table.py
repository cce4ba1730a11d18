"""Tables on the terminal that cut nothing off, however narrow it is."""

from typing import Any

from rich.table import Table


def build_text_table(*headings: str, fixed: int = 1, **options: Any) -> Table:
    """Make a table whose cells are folded onto further lines and never cut to an ellipsis.

    Args:
        *headings: of the columns.
        fixed: number of leading columns that keep their width while any other can be narrower;
            0 where their texts have no bounded length.
        **options: of `rich.build_text_table.Table`.
    """
    text_table = Table(**options)
    for number, heading in enumerate(headings):
        text_table.add_column(heading, overflow="fold", no_wrap=number < fixed)
    return text_table
