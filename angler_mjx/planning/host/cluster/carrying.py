"""Planners on their way to another machine: a planner of a file takes the file along."""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from angler_mjx.planning.register import PlannerSpec


@dataclass(frozen=True)
class Carried:
    """A planner, and the text of its file where it is of one."""

    spec: PlannerSpec
    text: bytes | None


def carry(spec: PlannerSpec) -> Carried:
    """A planner that can be made elsewhere.

    A file that was edited or removed since it was chosen is not taken along; who makes the planner
    says so.
    """
    file = spec.reference.file
    if file is None:
        return Carried(spec, None)
    text = _text(file)
    return Carried(spec, text if _digest(text) == spec.reference.sha256 else None)


def unpack(carried: Carried, put: Callable[[str, bytes], Path]) -> PlannerSpec:
    """The planner as it can be made here.

    Of the file that lies here at the same path, if it is the same: what lies beside it can then be
    imported. Else of the text that came along, which can import nothing that lay beside it.

    Args:
        carried: the planner.
        put: writes a file of a name and a text, and says where.
    """
    reference = carried.spec.reference
    file = reference.file
    if file is None or carried.text is None or _digest(_text(file)) == reference.sha256:
        return carried.spec
    there = put(file.name, carried.text)
    return replace(carried.spec, reference=replace(reference, module=str(there)))


def _text(file: Path) -> bytes | None:
    try:
        return file.read_bytes()
    except OSError:
        return None


def _digest(text: bytes | None) -> str | None:
    return None if text is None else hashlib.sha256(text).hexdigest()
