"""Flying candidates: thousands of flights in device calls of a fixed size."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial

import jax
import numpy as np

from angler_mjx.robot.vehicles.thrusters import FloatArray
from angler_mjx.sim.state import SimSpec
from angler_mjx.studies.flights import flying, kinds, measures
from angler_mjx.studies.flights.flying import FlightSettings
from angler_mjx.studies.flights.measures import FlightMeasures, ReferenceMotion
from angler_mjx.studies.tuning import knobs as turning
from angler_mjx.studies.tuning.knobs import Knob
from angler_mjx.studies.tuning.samples import FLIGHT_S, FlightSet

CHUNK = {"cpu": 256}
"""Flights in a device call: few enough to stay in a processor's cache ..."""
CHUNK_GPU = 8192
"""... and enough to fill a GPU."""
GRADIENT_MEASURES = ("ise_m2s", "energy_jpm", "swing_m", "jitter_us")
"""Measures whose derivatives objectives ask for."""

type Done = Callable[[int], None]
type SlopedMeasures = tuple[tuple[jax.Array, ...], FlightMeasures]
"""Derivatives of `GRADIENT_MEASURES`, and all measures."""


class TuningFlyer:
    """Flies gains of one stack; each program is compiled when it is first asked for."""

    def __init__(self, spec: SimSpec, knobs: Sequence[Knob], chunk: int | None = None) -> None:
        """A flyer.

        Args:
            spec: settings of the flights.
            knobs: that candidates turn.
            chunk: flights in a device call; chosen for the device if left out.
        """
        self._chunk = chunk or CHUNK.get(jax.default_backend(), CHUNK_GPU)
        measure_one = partial(_measure_flight, spec, tuple(knobs))
        self._program: Callable[..., FlightMeasures] = jax.jit(jax.vmap(measure_one))
        # Forward: there are few knobs and thousands of steps, of which nothing need be kept.
        self._sloped: Callable[..., SlopedMeasures] = jax.jit(
            jax.vmap(jax.jacfwd(_add_measures(measure_one), has_aux=True))
        )

    def fly(
        self, settings: FloatArray, flights: FlightSet, done: Done = lambda _: None
    ) -> FlightMeasures:
        """Measures [c, n] of n flights of each of c candidates.

        Args:
            settings: [c, n_knob].
            flights: n of them.
            done: told the number of flights after each device call.
        """
        return self._chunks(self._program, settings, flights, done)

    def slopes(
        self, settings: FloatArray, flights: FlightSet, done: Done = lambda _: None
    ) -> tuple[dict[str, FloatArray], FlightMeasures]:
        """Return measures [c, n], and derivatives [c, n, n_knob] of `GRADIENT_MEASURES` by name."""
        slopes, result = self._chunks(self._sloped, settings, flights, done)
        arrays = map(np.asarray, slopes)
        return dict(zip(GRADIENT_MEASURES, arrays, strict=True)), result

    def _chunks[T](
        self,
        program: Callable[..., T],
        settings: FloatArray,
        flights: FlightSet,
        done: Done,
    ) -> T:
        n_candidate, n = len(settings), len(flights.group)
        total = n_candidate * n
        size = min(self._chunk, total)
        parts = []
        for first in range(0, total, size):
            # The last chunk is filled up, so that the program is compiled once.
            rows = np.minimum(np.arange(first, first + size), total - 1)
            flown = kinds.select_rows((flights.settings, flights.reference), (rows % n).tolist())
            part = jax.tree.map(np.asarray, program(settings[rows // n], *flown))
            kept = min(size, total - first)
            parts.append(jax.tree.map(lambda leaf, kept=kept: leaf[:kept], part))
            done(kept)
        whole: T = jax.tree.map(
            lambda *leaves: np.concatenate(leaves).reshape(n_candidate, n, *leaves[0].shape[1:]),
            *parts,
        )
        return whole


def _measure_flight(
    spec: SimSpec,
    knobs: tuple[Knob, ...],
    settings: jax.Array,
    flight_settings: FlightSettings,
    reference: ReferenceMotion,
) -> FlightMeasures:
    """One flight of one candidate."""
    turned = replace(spec, gains=turning.apply_settings(spec, knobs, settings))
    flight = flying.fly_robot(turned, flight_settings, round(FLIGHT_S / spec.control_dt_s))
    return measures.measure_flight(flight, reference, flight_settings.plant, spec.control_dt_s)


def _add_measures(measure: Callable[..., FlightMeasures]) -> Callable[..., SlopedMeasures]:
    """The measures that have derivatives, and all of them beside."""

    def both(
        settings: jax.Array, flight_settings: FlightSettings, reference: ReferenceMotion
    ) -> SlopedMeasures:
        result = measure(settings, flight_settings, reference)
        return tuple(getattr(result, name) for name in GRADIENT_MEASURES), result

    return both
