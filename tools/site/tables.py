"""Extension of Sphinx: cells of tables that hold texts keep a width to read them in."""

from typing import Any

from docutils import nodes

CLASSES = ((60, "long"), (25, "middling"))
"""Numbers of characters above which a cell has a class of the style sheet."""


def mark_cells(app: object, doctree: nodes.document) -> None:
    """Mark cells by whose texts a narrow column would become many lines high."""
    del app
    for entry in doctree.findall(nodes.entry):
        size = len(entry.astext())
        entry["classes"] += [name for limit, name in CLASSES if size > limit][:1]


def setup(app: Any) -> dict[str, bool]:
    """Connect the function above to Sphinx."""
    app.connect("doctree-read", mark_cells)
    return {"parallel_read_safe": True}
