"""Terminal tables that wrap text instead of cutting it off."""

from rich.console import JustifyMethod
from rich.table import Table


def build_text_table(
    *headings: str,
    fixed: int = 1,
    title: str | None = None,
    title_justify: JustifyMethod = "center",
) -> Table:
    """Make a table whose cells wrap onto further lines instead of ending in an ellipsis.

    Args:
        *headings: headings of the columns.
        fixed: number of leading columns that keep their width while any other can be narrower;
            0 where their texts have no bounded length.
        title: title above the table.
        title_justify: side of the title.
    """
    text_table = Table(title=title, title_justify=title_justify)
    for number, heading in enumerate(headings):
        text_table.add_column(heading, overflow="fold", no_wrap=number < fixed)
    return text_table
