"""Particles that drift with the water for a day: our current against others' interpolation.

    python -m angler_experiments.ocean.drift --out runs/drift
    python parcels_drift.py runs/drift        # in an environment of its own, with parcels
    python -m angler_experiments.ocean.drift --out runs/drift

A thousand particles begin at sampled positions and depths of the tidal stream around a headland
(`angler_experiments.ocean.headland`) and drift with the water. Ours are advected in JAX by the
current that a scenario with ``type = "grid"`` flies in, in float32, by Runge-Kutta steps of fourth
order. They are compared with SciPy (``RegularGridInterpolator`` and ``solve_ivp``) and, once
``parcels_drift.py`` has written its tracks, with Parcels. ``--smoke`` takes few particles, asserts
expected values and needs neither Parcels nor a figure.
"""

import argparse
import json
from pathlib import Path
from typing import NotRequired, TypedDict

import jax
import jax.numpy as jnp
import numpy as np
import xarray
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from scipy.integrate import solve_ivp
from scipy.interpolate import RegularGridInterpolator

from angler_experiments.ocean import headland
from angler_mjx.world import currents
from angler_mjx.world.currents import Current, GridConfig
from angler_mjx.world.currents.gridded import Gridded

DAY_S, STEP_S, STEPS_PER_SAMPLE = 86_400.0, 300.0, 12
"""Duration [s], step [s], and steps per sample of a track: one sample per hour."""
MARGIN_M = 700.0
"""Distance to the file's edge below which particles are left out of the comparison."""
N_SCIPY_PARTICLES = 100
"""Number of particles that SciPy follows: a second each."""
MAX_DISTANCE_M = 1.0
"""Greatest distance after a day; see docs/how_to/ocean.md for the measured ones."""
MIDDLE = (headland.LATITUDE + 0.035, headland.LONGITUDE)
HOUR = 4
"""Hour of the plotted speeds: the tide runs."""

type Array = np.ndarray


class DriftComparison(TypedDict):
    """Distances between two sets of tracks."""

    particles: int
    median_m: float
    p99_m: float
    greatest_m: float
    median_by_hour_m: list[float]
    greatest_by_hour_m: list[float]


class ParcelsComparison(DriftComparison):
    """Distances to the tracks of Parcels."""

    version: str


class DriftResults(TypedDict):
    """Content of ``drift.json``."""

    particles: int
    clear_of_land: int
    path_m: dict[str, float]
    mean_speed_mps: float
    scipy: DriftComparison
    parcels: NotRequired[ParcelsComparison]


def build_current(path: Path) -> tuple[Gridded]:
    """Build the current of a world with its origin in the middle of the file, at its first time."""
    config = GridConfig(
        file=str(path),
        latitude=(MIDDLE[0], MIDDLE[0]),
        longitude=(MIDDLE[1], MIDDLE[1]),
        time=(headland.BEGIN, headland.BEGIN),
    )
    origin = jnp.zeros(3)
    (current,) = currents.sample_current(
        currents.build_samplers((config,), DAY_S), jax.random.key(0), origin, origin
    )
    if not isinstance(current, Gridded):
        raise TypeError(f"{path}: gives a {type(current).__name__}")
    return (current,)


def axes_m(current: Gridded) -> tuple[Array, Array]:
    """Return metres north and east of the origin at the knots of the field, in float64."""
    field = current.field
    at = [
        (knots - knots[int(current.knot[i])] - float(current.rest[i])) / float(current.rate[i])
        for i, knots in enumerate(field.knots[:2])
    ]
    return at[0], at[1]


def sample_starts(current: Gridded, count: int) -> Array:
    """Sample positions [count, 3] m in water over the whole file, 1 to 15 m below the surface."""
    y, x = axes_m(current)
    rng, positions = np.random.default_rng(0), np.zeros((0, 3))
    while len(positions) < count:
        fraction = rng.uniform(size=(count, 3))
        low, high = np.array([x[1], y[1], -15.0]), np.array([x[-2], y[-2], -1.0])
        p = low + fraction * (high - low)
        positions = np.concatenate([positions, p[is_in_water(current, p)]])
    return positions[:count]


def is_in_water(current: Gridded, p: Array) -> Array:
    """Return whether all eight knots around positions [n, 3] are water."""
    field = current.field
    y, x = axes_m(current)
    lower = [
        np.clip(np.searchsorted(axis, at, side="right") - 1, 0, len(axis) - 2)
        for axis, at in ((y, p[:, 1]), (x, p[:, 0]), (field.knots[2], -p[:, 2]))
    ]
    wet = np.ones(len(p), bool)
    for corner in np.ndindex(2, 2, 2):
        wet &= field.wet[tuple(k + c for k, c in zip(lower, corner, strict=True))]
    return wet


def integrate_tracks(current: Current, begin: Array) -> Array:
    """Return tracks [hour, n, 3] of particles by Runge-Kutta steps of fourth order, in JAX."""

    def velocity(p: jax.Array, t: jax.Array) -> jax.Array:
        return jax.vmap(currents.velocity, (None, 0, None))(current, p, t)

    def step(p: jax.Array, k: jax.Array) -> tuple[jax.Array, None]:
        t, h = k * STEP_S, STEP_S
        a = velocity(p, t)
        b = velocity(p + 0.5 * h * a, t + 0.5 * h)
        c = velocity(p + 0.5 * h * b, t + 0.5 * h)
        d = velocity(p + h * c, t + h)
        return p + h / 6.0 * (a + 2.0 * b + 2.0 * c + d), None

    def hour(p: jax.Array, first: jax.Array) -> tuple[jax.Array, jax.Array]:
        after, _ = jax.lax.scan(step, p, first + jnp.arange(STEPS_PER_SAMPLE, dtype=float))
        return after, after

    @jax.jit
    def day(p: jax.Array) -> jax.Array:
        hours = round(DAY_S / STEP_S) // STEPS_PER_SAMPLE
        return jax.lax.scan(hour, p, STEPS_PER_SAMPLE * jnp.arange(hours, dtype=float))[1]

    tracks = day(jnp.asarray(begin, float))
    return np.concatenate([begin[None], np.asarray(tracks, np.float64)])


def integrate_with_scipy(current: Gridded, begin: Array) -> Array:
    """Return tracks as `integrate_tracks`, by SciPy in float64 with a maximum error of 1 mm."""
    field = current.field
    y, x = axes_m(current)
    axes = (y, x, field.knots[2], field.knots[3])
    interpolate = RegularGridInterpolator(axes, field.values[..., :2].astype(float))
    low, high = (np.array([axis[end] for axis in axes]) for end in (0, -1))
    out = np.empty((round(DAY_S / STEP_S) // STEPS_PER_SAMPLE + 1, *begin.shape))
    for i, (px, py, pz) in enumerate(begin):

        def velocity(t: float, p: Array, depth: float = -pz) -> Array:
            at = np.clip([p[1], p[0], depth, t], low, high)
            velocity_mps: Array = interpolate(at)[0]
            return velocity_mps

        times = np.arange(len(out)) * STEPS_PER_SAMPLE * STEP_S
        # No step skips a whole cell or an hour's knot.
        solution = solve_ivp(
            velocity, (0.0, DAY_S), [px, py], t_eval=times, rtol=1e-8, atol=1e-3, max_step=600.0
        )
        out[:, i, :2], out[:, i, 2] = solution.y.T, pz
    return out


def write_flat_field(current: Gridded, path: Path) -> None:
    """Write the field on the plane of our drift, extended into land, for programs without land."""
    field = current.field
    y, x = axes_m(current)
    begin = np.datetime64(field.begin)
    time = begin + (1e9 * field.knots[3]).astype("timedelta64[ns]")
    axes = ("time", "depth", "lat", "lon")
    parts = field.values.transpose(3, 2, 0, 1, 4)
    xarray.Dataset(
        {"U": (axes, parts[..., 0]), "V": (axes, parts[..., 1])},
        coords={"time": time, "depth": field.knots[2], "lat": y, "lon": x},
    ).to_netcdf(path, engine="h5netcdf")


def compare_tracks(ours: Array, theirs: Array, clear: Array) -> DriftComparison:
    """Return distances between two sets of tracks, of particles that stayed clear of land."""
    distance_m = np.linalg.norm((ours - theirs)[:, clear, :2], axis=-1)
    return {
        "particles": int(clear.sum()),
        "median_m": float(np.median(distance_m[-1])),
        "p99_m": float(np.quantile(distance_m[-1], 0.99)),
        "greatest_m": float(distance_m[-1].max()),
        "median_by_hour_m": np.round(np.median(distance_m, axis=1), 6).tolist(),
        "greatest_by_hour_m": np.round(distance_m.max(axis=1), 6).tolist(),
    }


def run_study(out: Path, particles: int) -> DriftResults:
    """Make, compare and store the tracks; return the results."""
    out.mkdir(parents=True, exist_ok=True)
    current = build_current(headland.write_dataset(out / "headland.nc"))
    begin = sample_starts(current[0], particles)
    ours = integrate_tracks(current, begin)
    y, x = axes_m(current[0])
    # Parcels has no values beyond its knots, and between two hours a particle moves on.
    low, high = np.array([x[0], y[0]]) + MARGIN_M, np.array([x[-1], y[-1]]) - MARGIN_M
    is_inside = np.all((ours[..., :2] > low) & (ours[..., :2] < high), axis=(0, 2))
    clear = is_inside & np.all([is_in_water(current[0], p) for p in ours], axis=0)
    length = np.linalg.norm(np.diff(ours[..., :2], axis=0), axis=-1).sum(axis=0)
    scipy_particles = slice(0, N_SCIPY_PARTICLES)
    theirs = integrate_with_scipy(current[0], begin[scipy_particles])
    np.savez(out / "tracks.npz", ours=ours, scipy=theirs, clear=clear, begin=begin)
    write_flat_field(current[0], out / "flat.nc")
    results: DriftResults = {
        "particles": particles,
        "clear_of_land": int(clear.sum()),
        "path_m": {"median": float(np.median(length)), "greatest": float(length.max())},
        "mean_speed_mps": float(length.mean() / DAY_S),
        "scipy": compare_tracks(ours[:, scipy_particles], theirs, clear[scipy_particles]),
    }
    if (out / "parcels.npz").exists():
        with np.load(out / "parcels.npz") as stored:
            # Particles that stayed clear of land.
            is_all = np.ones(int(clear.sum()), bool)
            compared = compare_tracks(ours[:, clear], stored["tracks"], is_all)
            results["parcels"] = {"version": str(stored["version"]), **compared}
    (out / "drift.json").write_text(json.dumps(results, indent=2) + "\n")
    return results


def main() -> None:
    """Run the study of the command line."""
    parser = argparse.ArgumentParser(description="Particles that drift for a day.")
    parser.add_argument("--out", type=Path, default=Path("runs/drift"))
    parser.add_argument("--particles", type=int, default=1000)
    parser.add_argument("--smoke", action="store_true", help="few particles; assert the result")
    arguments = parser.parse_args()
    results = run_study(arguments.out, 12 if arguments.smoke else arguments.particles)
    print(json.dumps(results, indent=2))
    if arguments.smoke:
        assert results["scipy"]["greatest_m"] < MAX_DISTANCE_M, results
        assert results["mean_speed_mps"] > 0.05, results
        return

    print(plot_drift(arguments.out))


def plot_drift(folder: Path) -> Path:
    """Plot the tracks over the stream, and the distances of their ends; return the file."""
    with np.load(folder / "tracks.npz") as stored:
        ours, clear, scipy = stored["ours"], stored["clear"], stored["scipy"]
    with xarray.open_dataset(folder / "flat.nc", engine="h5netcdf") as flat:
        part = flat.isel(time=HOUR, depth=1).load()
    with xarray.open_dataset(folder / "headland.nc", engine="h5netcdf") as file:
        wet = np.isfinite(file["uo"].isel(time=HOUR, depth=1).values)
    results = json.loads((folder / "drift.json").read_text())
    figure = Figure(figsize=(10, 4.2), layout="tight")
    left, right = figure.subplots(1, 2, width_ratios=(1.5, 1))
    x, y = part["lon"].values / 1e3, part["lat"].values / 1e3
    speed = np.where(wet, np.hypot(part["U"], part["V"]), np.nan)
    left.set_facecolor("0.75")
    speed_mesh = left.pcolormesh(x, y, speed, cmap="Blues", vmin=0, shading="nearest")
    figure.colorbar(speed_mesh, ax=left, label=f"speed at hour {HOUR}, m/s")
    plotted = np.flatnonzero(clear)[:: max(1, int(clear.sum()) // 60)]
    left.plot(ours[:, plotted, 0] / 1e3, ours[:, plotted, 1] / 1e3, color="tab:red", lw=0.6)
    left.plot(*(ours[0, plotted, k] / 1e3 for k in (0, 1)), "k.", ms=2)
    left.set(xlabel="east, km", ylabel="north, km", aspect="equal")
    left.set_title(f"{len(plotted)} of {int(clear.sum())} particles, 24 h; land grey", fontsize=10)
    _plot_distances(right, "SciPy", ours[:, : scipy.shape[1]], scipy, clear[: scipy.shape[1]])
    if "parcels" in results:
        with np.load(folder / "parcels.npz") as stored:
            tracks = stored["tracks"]
        is_all = np.ones(tracks.shape[1], bool)
        _plot_distances(
            right, f"Parcels {results['parcels']['version']}", ours[:, clear], tracks, is_all
        )
    right.set(xlabel="hours", ylabel="distance from ours, m", yscale="log", xlim=(0, 24))
    right.axhline(1.0, color="0.5", ls=":", lw=1)
    right.legend(fontsize=8)
    right.set_title("median, and the farthest of all (dashed)", fontsize=10)
    path = folder / "drift.png"
    figure.savefig(path, dpi=110)
    return path


def _plot_distances(
    axes: Axes, name: str, ours: np.ndarray, theirs: np.ndarray, clear: np.ndarray
) -> None:
    """Plot distances between two sets of tracks, hour by hour."""
    distance_m = np.linalg.norm((ours - theirs)[1:, clear, :2], axis=-1)
    hours = np.arange(1, len(distance_m) + 1)
    (line,) = axes.plot(hours, np.median(distance_m, axis=1), label=name)
    axes.plot(hours, distance_m.max(axis=1), color=line.get_color(), ls="--", lw=1)


if __name__ == "__main__":
    main()
