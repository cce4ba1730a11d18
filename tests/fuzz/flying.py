"""Cases flown by an engine, and everything that must hold of a flight."""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import jax
import numpy as np

from angler_mjx.runs.simulator.simulator import Simulator
from angler_mjx.scenario.scenario import Scenario
from angler_mjx.sim.record import Sample
from angler_mjx.sim.state import Outcome

from .energy import MOST_DT_S, UNRESOLVED, Books
from .signals import Signals

FLYING = (Outcome.RUNNING, Outcome.REACHED)
RECORDED = ("p", "q", "nu", "pwm_us", "outcome")


@dataclass(frozen=True, kw_only=True)
class Fault:
    """Something that must not be, of one world."""

    kind: str
    world: int
    """Index in the run."""
    robot: int
    said: str

    def line(self) -> str:
        """For people."""
        return f"{self.kind}: world {self.world} robot {self.robot}: {self.said}"


@dataclass(kw_only=True)
class Flight:
    """What came of a tile by one engine; [W, R] leads where robots are meant."""

    first: int
    """Index of the first world."""
    tally: Any
    """NumPy arrays."""
    p: np.ndarray
    """[W, S, R, 3] m."""
    time_s: np.ndarray
    """[S] of these."""
    faults: list[Fault] = field(default_factory=list)
    worst_energy: float = 0.0
    """In parts of what is allowed."""
    fastest_radps: float = 0.0
    """Of all robots that fly."""


def fly(
    simulator: Simulator,
    worlds: Any,
    first: int,
    seen: Callable[[Sample], None] = lambda sample: None,
) -> Flight:
    """Worlds of one tile from start to end, looked at in every control step.

    Args:
        simulator: that records every control step.
        worlds: a tile of its worlds.
        first: index of the first.
        seen: called with the samples of each segment.
    """
    scenario = simulator.scenario
    dt = scenario.time.control_dt_s
    assert simulator.steps_per_sample == 1
    books = Books(
        vehicle=simulator.add_parameters(worlds).control.vehicle,
        current=worlds.environment.current,
        density=scenario.water.density_kgpm3,
        gravity=simulator.spec.water.gravity_mps2,
        dt=dt,
    )
    state, kept, fastest = simulator.reset(worlds), [], 0.0
    not_number: list[Fault] = []
    for segment in range(simulator.segments):
        state, sample = simulator.segment(worlds, state)
        seen(sample)
        begun = segment * simulator.segment_steps
        arrays = {name: np.asarray(getattr(sample, name)) for name in RECORDED}
        if sample.belief is not None:
            told = {f"told {name}": getattr(sample.belief, name) for name in ("p", "q", "nu")}
            arrays |= {name: np.asarray(x) for name, x in told.items()}
        not_number += numbers(arrays, first, begun, dt)
        flying = np.isin(arrays["outcome"], FLYING)
        spin = np.linalg.norm(arrays["nu"][..., 3:], axis=-1)
        fastest = max(fastest, float(np.max(spin, where=flying, initial=0.0)))
        for i in range(simulator.segment_steps):
            at = {name: x[:, i] for name, x in arrays.items()}
            books.add(at["p"], at["q"], at["nu"], at["pwm_us"], flying[:, i], (begun + i) * dt)
        kept.append(arrays["p"])
    tally = jax.tree.map(np.asarray, state.tally)
    flight = Flight(
        first=first,
        tally=tally,
        p=np.concatenate(kept, axis=1),
        time_s=dt * np.arange(simulator.segments * simulator.segment_steps),
        faults=not_number,
        worst_energy=float(books.worst.max()),
        fastest_radps=fastest,
    )
    flight.faults += _last(state, tally, first, scenario)
    for w, r in np.argwhere(books.worst > (1.0 if dt <= MOST_DT_S else UNRESOLVED)):
        said = (
            f"energy is off by {books.worst_j[w, r]:.3g} J, {books.worst[w, r]:.2f} of what is "
            f"allowed, of {books.turned_over[w, r]:.3g} J turned over"
        )
        flight.faults.append(Fault(kind="energy", world=first + int(w), robot=int(r), said=said))
    return flight


def numbers(arrays: dict[str, np.ndarray], first: int, begun: int, dt: float) -> list[Fault]:
    """What is no number, or no attitude or signal, in samples [W, S, R, ...].

    A robot that diverged is held where it last was sound: only its signals, and what it is told,
    may be anything.
    """
    faults, sound = [], arrays["outcome"] != Outcome.DIVERGED
    signals = arrays["pwm_us"]
    beyond = (signals < 1100.0) | (signals > 1900.0)
    bad = {"range of pwm_us": np.any(beyond & (signals != 0.0), axis=-1) & sound}
    for name in ("q", "told q"):
        if name in arrays:
            length = np.linalg.norm(arrays[name], axis=-1)
            bad[f"length of {name}"] = (np.abs(length - 1.0) > 1e-4) & (sound | (name == "q"))
    for name, x in arrays.items():
        if name != "outcome":
            always = name in ("p", "q", "nu")
            bad[f"number of {name}"] = ~np.all(np.isfinite(x), axis=-1) & (sound | always)
    for name, where in bad.items():
        for w, r in np.argwhere(where.any(axis=1)):
            step = int(np.argmax(where[w, :, r]))
            value = arrays[name.partition(" of ")[2]][w, step, r]
            said = f"{name} at {(begun + step) * dt:.2f} s: {value}"
            faults.append(Fault(kind="not a number", world=first + int(w), robot=int(r), said=said))
    return faults


def _last(state: Any, tally: Any, first: int, scenario: Scenario) -> list[Fault]:
    """What is wrong with the accounts and the state at the end."""
    end = {
        name: np.isfinite(np.asarray(getattr(state.vehicles, name))).all(axis=-1)
        for name in ("p", "q", "nu", "force_before")
    }
    numbers = tally.end_time_s, tally.path_length_m, tally.energy_j
    bad = {f"{name} at the end": ~fine for name, fine in end.items()}
    bad |= {
        name: ~(np.isfinite(x) & (x >= 0))
        for name, x in zip(("end_time_s", "path_length_m", "energy_j"), numbers, strict=True)
    }
    bad["end_time_s beyond the horizon"] = tally.end_time_s > scenario.time.horizon_s * (1 + 1e-5)
    bad["min_clearance_m"] = np.isnan(tally.min_clearance_m)
    bad["min_separation_m"] = np.isnan(tally.min_separation_m)
    hit = tally.touched != 0
    bad["impact_speed_mps"] = hit & ~np.isfinite(tally.impact_speed_mps)
    return [
        Fault(kind="not a number", world=first + int(w), robot=int(r), said=name)
        for name, where in bad.items()
        for w, r in np.argwhere(where)
    ]


def driver(signals: bool) -> Signals | None:
    """What drives the robots of a case."""
    return Signals() if signals else None
