"""The cells of a sweep: a scenario for each combination of its settings, all checked beforehand."""

import itertools
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from angler_mjx.errors import ConfigError
from angler_mjx.files import FaultyError, format_faults, validate_model
from angler_mjx.runs.multi_run import RUNS_FOLDER
from angler_mjx.runs.simulator.device_planning import build_device_planner
from angler_mjx.scenario.editing import remove_horizon, set_value
from angler_mjx.scenario.horizon_check import check_reachable
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.studies.sweep_axes import SettingAxis

MAX_CELLS = 10_000
"""Cells of a sweep."""
_MAX_NAME_LENGTH = 80
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
        parts = [f"{key.rpartition('.')[2]}_{name}" for key, name in self.names.items()]
        text = re.sub(r"[^A-Za-z0-9_.-]+", "_", "_".join(parts))[:_MAX_NAME_LENGTH].strip("._")
        return f"{RUNS_FOLDER}/{self.number:03d}_{text}"


def build_cells(
    table: Mapping[str, Any], axes: Sequence[SettingAxis], source: str
) -> tuple[StudyCell, ...]:
    """All cells; the last axis changes fastest.

    A cell whose world has another preset gets that one's horizon, unless one is set.

    Args:
        table: of the scenario (`angler_mjx.scenario.editing.scenario_table`).
        axes: to be varied.
        source: of the scenario, for messages.

    Raises:
        ConfigError: naming everything that is wrong with any of them, and the settings by which.
    """
    count = 1
    for axis in axes:
        count *= len(axis.values)
    if count > MAX_CELLS:
        raise ConfigError(f"--set: makes {count:,} cells; {MAX_CELLS:,} are the most: vary less")
    study_cells: list[StudyCell] = []
    faults: dict[str, list[Mapping[str, str]]] = {}
    for number, chosen in enumerate(itertools.product(*(range(len(x.values)) for x in axes))):
        names = {axis.key: axis.names[i] for axis, i in zip(axes, chosen, strict=True)}
        values = {axis.key: axis.values[i] for axis, i in zip(axes, chosen, strict=True)}
        try:
            scenario = _build_scenario(table, values)
        except FaultyError as error:
            for fault in error.faults:
                faults.setdefault(fault.text, []).append(names)
        except ConfigError as error:
            faults.setdefault(str(error), []).append(names)
        else:
            study_cells.append(
                StudyCell(number=number, names=names, values=values, scenario=scenario)
            )
    if faults:
        varied_keys = [axis.key for axis in axes if len(axis.values) > 1]
        raise ConfigError(
            format_faults(source, [_format_fault(x, at, varied_keys) for x, at in faults.items()])
        )
    return tuple(study_cells)


def _build_scenario(table: Mapping[str, Any], values: Mapping[str, Any]) -> Scenario:
    """The scenario of a cell.

    Raises:
        FaultyError, ConfigError: it cannot be flown.
    """
    scenario_table = dict(table)
    is_other_preset = values.get(
        "world.preset", scenario_table["world"].get("preset")
    ) != scenario_table["world"].get("preset")
    if is_other_preset and "time.horizon_s" not in values:
        scenario_table = remove_horizon(scenario_table)
    for key, value in values.items():
        scenario_table = set_value(scenario_table, key, value)
    scenario = validate_model(Scenario, scenario_table)
    spec = scenario.planner.planner_spec()
    if spec.reference.on_device:
        build_device_planner(scenario, spec)  # refuses what it can make no use of
    check_reachable(scenario)
    return scenario


def _format_fault(text: str, settings: Sequence[Mapping[str, str]], keys: Sequence[str]) -> str:
    """A fault, and the settings that all cells share that have it."""
    shared = [
        f"--set {key}={settings[0][key]}"
        for key in keys
        if all(x[key] == settings[0][key] for x in settings)
    ]
    return f"{text} ({' '.join(shared)})" if shared else text
