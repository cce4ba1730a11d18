"""A file with one fault in it."""

import difflib
import hashlib
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


def build_mutant(
    *, file: str, before: str, after: str, line: int, operator: str, fault: str
) -> Mutant:
    """Return the mutant that has ``after`` where the file has ``before``.

    Args:
        file: path in the tree.
        before: the file's text.
        after: the text with the fault.
        line: of the fault, from 1.
        operator: that made it.
        fault: text that tells this fault from all others of ``operator`` in this file.
    """
    diff = difflib.unified_diff(
        before.splitlines(), after.splitlines(), file, file, lineterm="", n=2
    )
    identity = f"{file}\0{operator}\0{fault}\0{before}"
    return Mutant(
        name=hashlib.sha256(identity.encode()).hexdigest()[:12],
        file=file,
        line=line,
        operator=operator,
        diff="\n".join(diff),
        code=after,
    )
