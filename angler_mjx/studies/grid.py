"""Grid of an experiment: a base scenario, axes of edits, and a cell for each combination of them.

Presets that vary a scenario build their cells of it: `angler_mjx.studies.sweep` and the scalability
study set single keys, `angler_mjx.studies.fleet_size` and `angler_mjx.studies.benchmark` merge
tables of changes.
"""

import itertools
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from angler_mjx.scenario.editing import merge_tables, set_value


@dataclass(frozen=True, kw_only=True)
class SettingAxis:
    """One key of a scenario, and the values that it takes."""

    key: str
    """Dotted."""
    values: tuple[object, ...]
    """Plain."""
    names: tuple[str, ...]
    """The values as they were written."""

    def edit(self, table: Mapping[str, object], value: object) -> dict[str, object]:
        """Return a table with one value of this axis.

        Args:
            table: of a scenario.
            value: one of `values`.

        Raises:
            ConfigError: the key leads nowhere in the table.
        """
        return set_value(dict(table), self.key, value)


@dataclass(frozen=True, kw_only=True)
class ChangesAxis(SettingAxis):
    """A named property of the worlds or robots, whose values are tables of changed keys.

    The key names the axis and is no key of the scenario.
    """

    def edit(self, table: Mapping[str, object], value: object) -> dict[str, object]:
        """Return a table with the changes of one value merged into it."""
        if not isinstance(value, Mapping):
            raise TypeError(f"{self.key}: changes are a table, not {value!r}")
        return merge_tables(table, value)


def build_changes_axis(key: str, changes: Mapping[str, Mapping[str, object]]) -> ChangesAxis:
    """Return the axis of some tables of changes by their names."""
    return ChangesAxis(key=key, names=tuple(changes), values=tuple(changes.values()))


@dataclass(frozen=True, kw_only=True)
class GridCell:
    """One combination of values, one of each axis."""

    number: int
    axes: tuple[SettingAxis, ...]
    indices: tuple[int, ...]
    """Of the value of each axis."""

    @property
    def names(self) -> dict[str, str]:
        """Names of the values by key."""
        return {axis.key: axis.names[i] for axis, i in zip(self.axes, self.indices, strict=True)}

    @property
    def values(self) -> dict[str, object]:
        """Values by key."""
        return {axis.key: axis.values[i] for axis, i in zip(self.axes, self.indices, strict=True)}

    @property
    def label(self) -> str:
        """Names of the values in one text; empty without axes."""
        return ", ".join(axis.names[i] for axis, i in zip(self.axes, self.indices, strict=True))

    def edit(self, table: Mapping[str, object]) -> dict[str, object]:
        """Return a table with all edits of this cell, those of the first axis first.

        Raises:
            ConfigError: an edit does not fit the table.
        """
        edited = dict(table)
        for axis, i in zip(self.axes, self.indices, strict=True):
            edited = axis.edit(edited, axis.values[i])
        return edited


def find_reserved_key(changes: Mapping[str, object], replacements: Mapping[str, str]) -> str | None:
    """Return what to write instead of the first reserved key of some changes; None without any.

    Args:
        changes: keys of a scenario, in the file of a study.
        replacements: keys of the file, by the scenario's keys that they stand for; one dot at most.
    """
    for key, replacement in replacements.items():
        name, _, inner = key.partition(".")
        value = changes.get(name)
        if name in changes and (not inner or (isinstance(value, Mapping) and inner in value)):
            return f"{key}: give {replacement} instead"
    return None


def count_cells(axes: Sequence[SettingAxis]) -> int:
    """Return the number of combinations of values."""
    return math.prod(len(axis.values) for axis in axes)


def iterate_cells(axes: Sequence[SettingAxis]) -> Iterator[GridCell]:
    """Yield all combinations of values; the last axis changes fastest."""
    indices = itertools.product(*(range(len(axis.values)) for axis in axes))
    for number, chosen in enumerate(indices):
        yield GridCell(number=number, axes=tuple(axes), indices=chosen)
