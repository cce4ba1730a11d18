"""The cells of a sweep: a scenario for each combination of its settings, all checked beforehand."""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.files import FaultyError, check, listed
from angler_mjx.runs.several import RUNS
from angler_mjx.runs.simulator.on_device import device_planner
from angler_mjx.scenario.editing import with_value, without_horizon
from angler_mjx.scenario.reachable import check_reachable
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.settings import SettingAxis

MOST = 10_000
"""Cells of a sweep."""
_NAME = 80
"""Characters of a run folder's name."""


@dataclass(frozen=True, kw_only=True)
class StudyCell:
    """One combination of settings."""

    number: int
    names: Mapping[str, str]
    """Values by key, as they were written."""
    values: Mapping[str, Any]
    """Values by key."""
    scenario: Scenario

    @property
    def path(self) -> str:
        """Of its run, below the sweep's folder."""
        words = [f"{key.rpartition('.')[2]}_{name}" for key, name in self.names.items()]
        text = re.sub(r"[^A-Za-z0-9_.-]+", "_", "_".join(words))[:_NAME].strip("._")
        return f"{RUNS}/{self.number:03d}_{text}"


def cells(
    table: Mapping[str, Any], axes: Sequence[SettingAxis], source: str
) -> tuple[StudyCell, ...]:
    """All cells; the last axis changes fastest.

    A cell whose world has another preset gets that one's horizon, unless one is set.

    Args:
        table: of the scenario (`angler_mjx.scenario.editing.table_of`).
        axes: to be varied.
        source: of the scenario, for messages.

    Raises:
        ConfigError: naming everything that is wrong with any of them, and the settings by which.
    """
    count = 1
    for axis in axes:
        count *= len(axis.values)
    if count > MOST:
        raise ConfigError(f"--set: makes {count:,} cells; {MOST:,} are the most: vary less")
    made: list[StudyCell] = []
    faults: dict[str, list[Mapping[str, str]]] = {}
    for number, chosen in enumerate(itertools.product(*(range(len(x.values)) for x in axes))):
        names = {axis.key: axis.names[i] for axis, i in zip(axes, chosen, strict=True)}
        values = {axis.key: axis.values[i] for axis, i in zip(axes, chosen, strict=True)}
        try:
            scenario = _scenario(table, values)
        except FaultyError as error:
            for fault in error.faults:
                faults.setdefault(fault.text, []).append(names)
        except ConfigError as error:
            faults.setdefault(str(error), []).append(names)
        else:
            made.append(StudyCell(number=number, names=names, values=values, scenario=scenario))
    if faults:
        several = [axis.key for axis in axes if len(axis.values) > 1]
        raise ConfigError(listed(source, [_told(x, at, several) for x, at in faults.items()]))
    return tuple(made)


def _scenario(table: Mapping[str, Any], values: Mapping[str, Any]) -> Scenario:
    """The scenario of a cell.

    Raises:
        FaultyError, ConfigError: it cannot be flown.
    """
    whole = dict(table)
    anew = values.get("world.preset", whole["world"].get("preset")) != whole["world"].get("preset")
    if anew and "time.horizon_s" not in values:
        whole = without_horizon(whole)
    for key, value in values.items():
        whole = with_value(whole, key, value)
    made = check(Scenario, whole)
    spec = made.planner.chosen()
    if spec.reference.on_device:
        device_planner(made, spec)  # refuses what it can make no use of
    check_reachable(made)
    return made


def _told(text: str, at: Sequence[Mapping[str, str]], keys: Sequence[str]) -> str:
    """A fault, and the settings that all cells share that have it."""
    shared = [f"--set {key}={at[0][key]}" for key in keys if all(x[key] == at[0][key] for x in at)]
    return f"{text} ({' '.join(shared)})" if shared else text
