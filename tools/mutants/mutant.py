"""A file with one fault in it."""

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """A file with one fault."""

    name: str
    """Of the file's bytes and the fault: the same fault in a file that changed has another."""
    file: str
    """Path in the tree, with slashes."""
    line: int
    operator: str
    diff: str
    code: str
    """The whole file."""
