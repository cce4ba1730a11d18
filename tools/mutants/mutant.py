"""File with one fault in it."""

import difflib
import hashlib
from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Mutant:
    """File with one fault."""

    name: str
    """Hash of the file's bytes and the fault: the same fault in a changed file has another name."""
    file: str
    """Path in the tree, with slashes."""
    line: int
    operator: str
    diff: str
    code: str
    """Text of the whole file."""


def build_mutant(
    *, file: str, before: str, after: str, line: int, operator: str, fault: str
) -> Mutant:
    """Return the mutant that has ``after`` where the file has ``before``.

    Args:
        file: path in the tree.
        before: the file's text.
        after: the text with the fault.
        line: line of the fault, from 1.
        operator: operator of the fault.
        fault: text that identifies this fault among all others of ``operator`` in this file.
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
