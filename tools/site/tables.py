"""Extension of Sphinx: classes of the style sheet for cells of tables and for long names."""

from typing import Any

from docutils import nodes

CLASSES = ((60, "long"), (18, "middling"))
"""Numbers of characters above which a cell has a class of the style sheet."""


LONG_WORD = (30, "breaks")
"""Number of characters above which a word of code breaks on a phone, and its class."""


def mark_cells(app: object, doctree: nodes.document) -> None:
    """Mark cells by whose texts a narrow column would become many lines high."""
    del app
    for entry in doctree.findall(nodes.entry):
        size = len(entry.astext())
        entry["classes"] += [name for limit, name in CLASSES if size > limit][:1]


def mark_words(app: object, doctree: nodes.document) -> None:
    """Mark code with words that are wider than a phone."""
    del app
    limit, name = LONG_WORD
    for literal in doctree.findall(nodes.literal):
        if any(len(word) > limit for word in literal.astext().split()):
            literal["classes"].append(name)


def setup(app: Any) -> dict[str, bool]:
    """Connect the functions above to Sphinx."""
    app.connect("doctree-read", mark_cells)
    app.connect("doctree-read", mark_words)
    return {"parallel_read_safe": True}
