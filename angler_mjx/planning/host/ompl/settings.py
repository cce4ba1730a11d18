"""Settings of OMPL's planners: shared ones, and OMPL's own parameters.

A parameter that is None keeps OMPL's own value; its field knows the setter and the bounds.
"""

import math
from dataclasses import dataclass, field, fields
from typing import Any, Literal

from angler_mjx.errors import ConfigError

type Mode = Literal["composite", "prioritised"]
type Simplify = Literal["shortcut", "ompl", "none"]
type Moving = Literal["timed", "still", "ignored"]


ROADMAPS = ("PRM", "PRMstar")
"""Planners that make a roadmap, and end by the clock alone."""


@dataclass(frozen=True, kw_only=True)
class OmplSettings:
    """Settings that all planners share."""

    mode: Mode = "composite"
    """All robots in one space; or one after another, the earlier ones as obstacles in time."""
    simplify: Simplify = "shortcut"
    """Treatment of the path: this project's shortcuts, OMPL's ``PathSimplifier``, or none."""
    time_limit_s: float | None = None
    """Wall time for all of it; the problem's deadline where that is less or this is left out."""
    edge_limit: int | None = None
    """Limit of edges of a search, which then ends with its best path; unlike the clock, the same
    on every machine. PRM and PRMstar cannot."""
    first: bool = False
    """Whether planners that go on improving end with their first path."""
    heading: bool = False
    """Whether headings are planned too: four numbers a robot, from its heading back to it."""
    arm: bool = False
    """Whether the joints of arms are planned too, with headings: four numbers a robot and those of
    its joints, from their start to any posture at the goal. In composite mode only."""
    margin_m: float = 0.05
    """Kept between the robots' spheres and anything else."""
    moving: Moving = "timed"
    """Treatment of known moving obstacles: the team waits at its starts until its path is clear;
    they stay where they are at t = 0; or they are ignored."""
    thrust_share: float = 0.8
    """Of the speed at full thrust that may be used through the water."""
    turn_radps: float = 0.5
    """Fastest turn, where headings are planned."""
    points: int = 32
    """Most points of one path, where a current has edges cut in pieces; not more than the run's."""

    @property
    def joints(self) -> bool:
        """Return whether paths are trajectories of joints."""
        return self.heading or self.arm


def _number_field(setter: str, low: float, high: float = math.inf) -> Any:
    return field(default=None, metadata={"set": setter, "low": low, "high": high})


def _flag_field(setter: str) -> Any:
    return field(default=None, metadata={"set": setter, "low": False, "high": True})


@dataclass(frozen=True, kw_only=True)
class RRTConnectSettings(OmplSettings):
    """Of RRTConnect."""

    range_m: float | None = _number_field("setRange", 0.0)
    """Longest edge, in the space of the whole team; 0: a fifth of the space's extent."""
    intermediate_states: bool | None = _flag_field("setIntermediateStates")


@dataclass(frozen=True, kw_only=True)
class RRTSettings(OmplSettings):
    """Of RRT."""

    range_m: float | None = _number_field("setRange", 0.0)
    goal_bias: float | None = _number_field("setGoalBias", 0.0, 1.0)
    intermediate_states: bool | None = _flag_field("setIntermediateStates")


@dataclass(frozen=True, kw_only=True)
class RRTstarSettings(OmplSettings):
    """Of RRTstar, InformedRRTstar and SORRTstar."""

    range_m: float | None = _number_field("setRange", 0.0)
    goal_bias: float | None = _number_field("setGoalBias", 0.0, 1.0)
    rewire_factor: float | None = _number_field("setRewireFactor", 1.0)
    k_nearest: bool | None = _flag_field("setKNearest")
    delay_collision_checking: bool | None = _flag_field("setDelayCC")
    tree_pruning: bool | None = _flag_field("setTreePruning")
    prune_threshold: float | None = _number_field("setPruneThreshold", 0.0, 1.0)
    pruned_measure: bool | None = _flag_field("setPrunedMeasure")
    informed_sampling: bool | None = _flag_field("setInformedSampling")
    sample_rejection: bool | None = _flag_field("setSampleRejection")
    new_state_rejection: bool | None = _flag_field("setNewStateRejection")
    admissible_cost_to_come: bool | None = _flag_field("setAdmissibleCostToCome")
    ordered_sampling: bool | None = _flag_field("setOrderedSampling")
    batch_size: int | None = _number_field("setBatchSize", 1)
    focus_search: bool | None = _flag_field("setFocusSearch")
    sampling_attempts: int | None = _number_field("setNumSamplingAttempts", 1)


@dataclass(frozen=True, kw_only=True)
class BITstarSettings(OmplSettings):
    """Of BITstar."""

    samples_per_batch: int | None = _number_field("setSamplesPerBatch", 1)
    rewire_factor: float | None = _number_field("setRewireFactor", 1.0)
    use_k_nearest: bool | None = _flag_field("setUseKNearest")
    pruning: bool | None = _flag_field("setPruning")
    prune_threshold: float | None = _number_field("setPruneThresholdFraction", 0.0, 1.0)
    strict_queue_ordering: bool | None = _flag_field("setStrictQueueOrdering")
    delay_rewiring: bool | None = _flag_field("setDelayRewiringUntilInitialSolution")
    just_in_time_sampling: bool | None = _flag_field("setJustInTimeSampling")
    drop_samples_on_prune: bool | None = _flag_field("setDropSamplesOnPrune")
    stop_on_improvement: bool | None = _flag_field("setStopOnSolnImprovement")


@dataclass(frozen=True, kw_only=True)
class AORRTCSettings(OmplSettings):
    """Of AORRTC."""

    range_m: float | None = _number_field("setRange", 0.0)


@dataclass(frozen=True, kw_only=True)
class PRMSettings(OmplSettings):
    """Of PRM."""

    max_nearest_neighbors: int | None = _number_field("setMaxNearestNeighbors", 1)


@dataclass(frozen=True, kw_only=True)
class PRMstarSettings(OmplSettings):
    """Of PRMstar, which chooses its neighbours itself."""


@dataclass(frozen=True, kw_only=True)
class FMTSettings(OmplSettings):
    """Of FMT and BFMT, which are begun anew with twice the samples where they find nothing."""

    samples: int | None = _number_field("setNumSamples", 1)
    radius_multiplier: float | None = _number_field("setRadiusMultiplier", 0.1)
    nearest_k: bool | None = _flag_field("setNearestK")
    cache_collision_checks: bool | None = _flag_field("setCacheCC")
    heuristics: bool | None = _flag_field("setHeuristics")
    extended: bool | None = _flag_field("setExtendedFMT")


@dataclass(frozen=True, kw_only=True)
class KPIECE1Settings(OmplSettings):
    """Of KPIECE1."""

    range_m: float | None = _number_field("setRange", 0.0)
    goal_bias: float | None = _number_field("setGoalBias", 0.0, 1.0)
    border_fraction: float | None = _number_field("setBorderFraction", 0.0, 1.0)
    failed_expansion_score: float | None = _number_field(
        "setFailedExpansionCellScoreFactor", 0.0, 1.0
    )
    min_valid_path_fraction: float | None = _number_field("setMinValidPathFraction", 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class BKPIECE1Settings(OmplSettings):
    """Of BKPIECE1."""

    range_m: float | None = _number_field("setRange", 0.0)
    border_fraction: float | None = _number_field("setBorderFraction", 0.0, 1.0)
    failed_expansion_score: float | None = _number_field(
        "setFailedExpansionCellScoreFactor", 0.0, 1.0
    )
    min_valid_path_fraction: float | None = _number_field("setMinValidPathFraction", 0.0, 1.0)


@dataclass(frozen=True, kw_only=True)
class LBKPIECE1Settings(OmplSettings):
    """Of LBKPIECE1."""

    range_m: float | None = _number_field("setRange", 0.0)
    border_fraction: float | None = _number_field("setBorderFraction", 0.0, 1.0)
    min_valid_path_fraction: float | None = _number_field("setMinValidPathFraction", 0.0, 1.0)


_BOUNDS = {
    "time_limit_s": (0.0, math.inf),
    "edge_limit": (1, math.inf),
    "margin_m": (0.0, math.inf),
    "thrust_share": (0.01, 1.0),
    "turn_radps": (0.01, math.inf),
    "points": (2, 1024),
}


def ompl_parameters(settings: OmplSettings) -> dict[str, int | float | str]:
    """Return OMPL's setters and their values."""
    return {
        each.metadata["set"]: value
        for each in fields(settings)
        if "set" in each.metadata and (value := getattr(settings, each.name)) is not None
    }


def check_settings(planner: str, settings: OmplSettings) -> None:
    """Check the numbers.

    Raises:
        ConfigError: one is out of its bounds, or there is no such choice.
    """
    choices = {
        "mode": ("composite", "prioritised"),
        "simplify": ("shortcut", "ompl", "none"),
        "moving": ("timed", "still", "ignored"),
    }
    for key, names in choices.items():
        if getattr(settings, key) not in names:
            raise ConfigError(
                f"planner.{planner}.{key} = {getattr(settings, key)!r}: give one of "
                + ", ".join(names)
            )
    if settings.arm and settings.mode != "composite":
        raise ConfigError(
            f'planner.{planner}.mode = "{settings.mode}": joints of arms are planned for the whole '
            'team at once; leave out arm, or give mode = "composite"'
        )
    if settings.arm and planner in ROADMAPS:
        raise ConfigError(
            f"planner.{planner}.arm: it runs on beyond its time limit where links are checked; "
            "leave out arm, or take a planner such as RRTConnect"
        )
    if settings.edge_limit is not None and planner in ROADMAPS:
        raise ConfigError(
            f"planner.{planner}.edge_limit: it ends by the clock alone; give time_limit_s"
        )
    for each in fields(settings):
        value = getattr(settings, each.name)
        meta = each.metadata
        low, high = _BOUNDS.get(each.name, (meta.get("low"), meta.get("high")))
        if value is None or low is None or high is None:
            continue
        if not low <= value <= high:
            raise ConfigError(
                f"planner.{planner}.{each.name} = {value}: give {low:g} to {high:g}"
                if high < math.inf
                else f"planner.{planner}.{each.name} = {value}: give at least {low:g}"
            )
