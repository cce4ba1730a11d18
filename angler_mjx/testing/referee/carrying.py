"""Task carry for the referee: arrival of the held body by its recorded poses, and its grips."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from angler_mjx.testing.referee.geometry import Floats, rotate_back

WELD_M, WELD_RAD = 1e-3, 5e-3
"""Offset of a robot from its grip that a weld allows: it is soft, and as stiff as contact."""


@dataclass(frozen=True, kw_only=True)
class CarryRules:
    """Rules of ``config.json`` for a body that robots hold together."""

    body: int
    """Row of the obstacles."""
    goal_m: Floats
    """[3] in W."""
    turn_rad: float
    """Turn about z up, from its attitude at the start to that at the goal."""
    tolerance_m: float
    tolerance_rad: float
    hold_steps: int
    """Control steps for which the body has to be at its goal."""
    break_force_n: float | None
    """Force above which a grip breaks; None for never."""
    max_slip_m: float | None
    """Slip beyond which jaws have lost the body; None of welds."""
    by_end_effector: bool
    is_gripped_in_flight: bool
    """Whether grippers begin open and close at the body."""

    @property
    def can_drop(self) -> bool:
        """Whether a robot can lose the body."""
        return self.break_force_n is not None or self.max_slip_m is not None


@dataclass(frozen=True, kw_only=True)
class CargoRecord:
    """Recorded poses of the body; T states."""

    p: Floats
    """[T, 3] in W."""
    q: Floats
    """[T, 4]."""


def read_carry_rules(table: Mapping[str, Any], control_dt_s: float) -> CarryRules | None:
    """Return the rules of a run; None where robots hold nothing together.

    Args:
        table: task of the run.
        control_dt_s: control period of the run.
    """
    if table.get("type") != "carry":
        return None
    hold_s = float(table.get("hold_s", 0.0))
    has_jaws = table.get("closing_force_n") is not None
    limit = table.get("break_force_n")
    return CarryRules(
        body=int(table["body"]),
        goal_m=np.array(table["to_m"], float),
        turn_rad=float(np.radians(table["turn_deg"])),
        tolerance_m=float(table["tolerance_m"]),
        tolerance_rad=float(np.radians(table["tolerance_deg"])),
        hold_steps=max(1, int(np.ceil(hold_s / control_dt_s - 1e-6))),
        break_force_n=None if limit is None else float(limit),
        max_slip_m=float(table["max_slip_m"]) if has_jaws else None,
        by_end_effector=table.get("hold", "hull") == "end_effector",
        is_gripped_in_flight=table.get("approach") is not None,
    )


def find_error(rules: CarryRules, cargo: CargoRecord) -> tuple[Floats, Floats]:
    """Return the distances [T] m of the body from its goal, and the angles [T] rad."""
    half = 0.5 * rules.turn_rad
    wanted = _multiply(np.array([np.cos(half), 0.0, 0.0, np.sin(half)]), cargo.q[0])
    apart = _multiply(_conjugate(wanted), cargo.q)
    angle: Floats = 2.0 * np.arctan2(np.linalg.norm(apart[:, 1:], axis=1), np.abs(apart[:, 0]))
    distance: Floats = np.linalg.norm(cargo.p - rules.goal_m, axis=1)
    return distance, angle


def find_margin(rules: CarryRules, cargo: CargoRecord, every: int) -> Floats:
    """Return by how much [T] the body is short of having arrived: below zero it has.

    Metres of the distance or rad of the angle, whichever is worse, and the worst of all states for
    which it has to stay; inf before the first steps are over.

    Args:
        rules: of the run.
        cargo: record of the body.
        every: control steps between states.
    """
    distance, angle = find_error(rules, cargo)
    short = np.maximum(distance - rules.tolerance_m, angle - rules.tolerance_rad)
    short[0] = np.inf  # the start is no step of the flight
    window = max(1, rules.hold_steps // every)
    padded = np.concatenate([np.full(window - 1, np.inf), short])
    margin: Floats = np.max(np.lib.stride_tricks.sliding_window_view(padded, window), axis=1)
    return margin


def find_slip(
    cargo: CargoRecord, point_m: Floats, q: Floats | None, first: int
) -> tuple[Floats, Floats]:
    """Return how far [T] m and rad a grip is from its first pose in the body's frame; 0 before.

    Args:
        cargo: record of the body.
        point_m: [T, 3] point of the grip in W.
        q: [T, 4] attitude of what holds the body; None where it is not recorded.
        first: state in which it took hold; T for never.
    """
    if first >= len(point_m):
        return np.zeros(len(point_m)), np.zeros(len(point_m))
    before = np.arange(len(point_m)) < first
    in_body = rotate_back(cargo.q, point_m - cargo.p)
    slip: Floats = np.linalg.norm(in_body - in_body[first], axis=1)
    slip[before] = 0.0
    if q is None:
        return slip, np.zeros_like(slip)
    turned = _multiply(_conjugate(cargo.q), q)
    apart = _multiply(_conjugate(turned[first]), turned)
    angle: Floats = 2.0 * np.arctan2(np.linalg.norm(apart[:, 1:], axis=1), np.abs(apart[:, 0]))
    angle[before] = 0.0
    return slip, angle


def _conjugate(q: Floats) -> Floats:
    conjugate: Floats = q * np.array([1.0, -1.0, -1.0, -1.0])
    return conjugate


def _multiply(first: Floats, second: Floats) -> Floats:
    """Return the products [..., 4] of quaternions [..., 4] (wxyz), of unit length."""
    w = first[..., :1] * second[..., :1] - np.sum(
        first[..., 1:] * second[..., 1:], axis=-1, keepdims=True
    )
    axis = (
        first[..., :1] * second[..., 1:]
        + second[..., :1] * first[..., 1:]
        + np.cross(first[..., 1:], second[..., 1:])
    )
    product = np.concatenate([w, axis], axis=-1)
    unit: Floats = product / np.linalg.norm(product, axis=-1, keepdims=True)
    return unit
