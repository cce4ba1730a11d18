"""The study: scores of references, published sets and the identified set; files of results."""

import json
import math
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from angler_experiments.validate_hinsdale import (
    bands,
    figures,
    horizons,
    identify,
    parameters,
    references,
)
from angler_experiments.validate_hinsdale.batch import RunBatch, build_batch, simulate_batch
from angler_experiments.validate_hinsdale.campaign import Run, read_campaign
from angler_experiments.validate_hinsdale.parameters import LABELS, SPREAD
from angler_experiments.validate_hinsdale.references import Prediction
from angler_experiments.validate_hinsdale.scores import RunScores, median_scores, score_run
from angler_experiments.validate_hinsdale.split import training_stems
from angler_experiments.validate_hinsdale.tracks import Track, build_track
from angler_experiments.validate_hinsdale.vehicle import (
    SOURCE_SET,
    CampaignVehicle,
    build_campaign_vehicle,
)
from angler_mjx.files import JsonTable
from angler_mjx.progress import Progress

type Array = np.ndarray

PUBLISHED = ("wu2018", "blue_gazebo", "von_benzon2022", SOURCE_SET)
IDENTIFIED = "hinsdale2023_identified"
N_DIRECTIONS = 6
"""Number of reported directions that the data do not determine."""


@dataclass(frozen=True, kw_only=True)
class StudySettings:
    """Size of the identification."""

    samples: int = 100
    iterations: int = identify.ITERATIONS
    refits: bool = False
    """Whether each sample is fitted anew instead of by one step from the fit of all runs."""
    seed: int = 0


@dataclass(frozen=True, kw_only=True)
class Identification:
    """Identified parameters and what they predict."""

    vector: Array
    """[k] from all training runs."""
    vectors: Array
    """[sample, k] from bootstrap samples."""
    information: Array
    """[k, k] of all training runs."""
    paths: list[Array]
    """For each run [sample, n, 3] roll, pitch, heave with errors of training runs."""
    parameter_paths: list[Array]
    """The same from sampled parameters alone."""
    seconds: dict[str, float]


def run_study(
    data: Path, out: Path, settings: StudySettings, progress: Progress | None = None
) -> str:
    """Run the study, write its files, and return a table of medians.

    Args:
        data: folder of the campaign's files.
        out: folder of the results.
        settings: size of the identification.
        progress: receives the progress.

    Raises:
        ConfigError: see `campaign.read_campaign`.
    """
    progress = progress or Progress()
    progress.describe("reading the recordings")
    runs = read_campaign(data)
    tracks = [build_track(run) for run in runs if run.copy_of is None]
    training = set(training_stems([track.stem for track in tracks]))
    batch = build_batch(tracks)
    predictions = predict_all(tracks, batch, progress)
    vehicles = {name: build_campaign_vehicle(name) for name in PUBLISHED}
    identification = None
    if settings.samples:
        identification = identify_runs(tracks, batch, training, settings, progress)
        progress.describe("predictions of the identified set")
        vehicle = parameters.apply_parameters(
            build_campaign_vehicle(SOURCE_SET), jnp.asarray(identification.vector)
        )
        predictions["balance_identified"] = [
            references.predict_balance(vehicle, track, keeps_initial=True) for track in tracks
        ]
        predictions[IDENTIFIED] = predict_set(vehicle, tracks, batch)
        vehicles[IDENTIFIED] = vehicle
    scores = {
        name: {
            track.stem: score_run(track, made.angles_rad, made.p_m)
            for track, made in zip(tracks, of_runs, strict=True)
        }
        for name, of_runs in predictions.items()
    }
    progress.describe("errors after a few steps")
    results: dict[str, Mapping[str, object]] = {
        "runs": describe_runs(runs, tracks, training),
        "medians": summarise(scores, training),
        "scores": scores,
        "better": count_better(scores, training),
        "horizons": _describe_horizons(runs, tracks, training, vehicles),
    }
    if identification is not None:
        progress.describe("coverage of the bands")
        results["identification"] = describe(identification, tracks, training)
    out.mkdir(parents=True, exist_ok=True)
    (out / "results.json").write_text(format_results(results))
    paths = identification.paths if identification is not None else None
    progress.describe("figures")
    figures.plot_overlays(out, tracks, predictions, paths, training)
    return format_medians(summarise(scores, training))


def predict_all(
    tracks: Sequence[Track], batch: RunBatch, progress: Progress
) -> dict[str, list[Prediction]]:
    """Return the predictions of references and published sets for each run."""
    progress.describe(f"predictions without simulation of {len(tracks)} runs")
    source = build_campaign_vehicle(SOURCE_SET)
    of_track: dict[str, Callable[[Track], Prediction]] = {
        "constant": references.predict_constant,
        "persistence": references.predict_persistence,
        "balance": lambda track: references.predict_balance(source, track),
        "balance_from_start": lambda track: references.predict_balance(
            source, track, keeps_initial=True
        ),
    }
    made = {name: [predict(track) for track in tracks] for name, predict in of_track.items()}
    for name in PUBLISHED:
        progress.describe(f"predictions of the set {name}")
        made[name] = predict_set(build_campaign_vehicle(name), tracks, batch)
    return made


def predict_set(
    vehicle: CampaignVehicle, tracks: Sequence[Track], batch: RunBatch
) -> list[Prediction]:
    """Return the simulated motion of each run."""
    motion = simulate_batch(vehicle, batch)
    angles, p = np.asarray(motion.angles_rad, float), np.asarray(motion.p_m, float)
    return [Prediction(angles_rad=angles[i], p_m=p[i]) for i in range(len(tracks))]


def identify_runs(
    tracks: Sequence[Track],
    batch: RunBatch,
    training: set[str],
    settings: StudySettings,
    progress: Progress,
) -> Identification:
    """Identify parameters from the training runs and their bootstrap samples; predict all runs."""
    vehicle = build_campaign_vehicle(SOURCE_SET)
    index = np.array([i for i, track in enumerate(tracks) if track.stem in training])
    train_batch: RunBatch = jax.tree.map(lambda x: x[index], batch)
    seconds = {}
    progress.describe(f"fit of {len(index)} runs, {settings.iterations} iterations")
    begin = time.perf_counter()
    zero, ones = jnp.zeros(len(LABELS)), jnp.ones(len(index))
    fit = identify.identify(vehicle, train_batch, ones, zero, settings.iterations)
    vector, information = np.asarray(fit.vector), np.asarray(fit.information)
    seconds["fit_with_compiling"] = time.perf_counter() - begin
    sample = identify.sample_bootstrap(len(index), settings.samples, settings.seed)
    how = "fitted anew" if settings.refits else "by one step from the fit"
    progress.describe(f"{settings.samples} bootstrap samples, {how}")
    progress.start(settings.samples, unit="bootstrap samples")
    begin = time.perf_counter()
    if settings.refits:
        vectors = identify.identify_samples(
            vehicle, train_batch, sample, settings.iterations, progress.advance
        )
    else:
        vectors = identify.linearised_samples(fit, vehicle, train_batch, sample)
        progress.advance(settings.samples)
    seconds["bootstrap_with_compiling"] = time.perf_counter() - begin
    progress.describe(f"bands of {settings.samples} samples in {len(tracks)} runs")
    simulated = bands.coordinates_of(bands.simulate_samples(vehicle, jnp.asarray(vectors), batch))
    train_tracks = [tracks[i] for i in index]
    errors = bands.out_of_bag_errors(train_tracks, simulated[:, index], sample.counts)
    rng = np.random.default_rng(settings.seed)
    # Several errors for each sample: 95 % bands of few samples would be their extremes.
    repeated = np.repeat(simulated, 10, axis=0)
    return Identification(
        vector=vector,
        vectors=vectors,
        information=information,
        paths=[bands.predictive_paths(repeated[:, i], errors, rng) for i in range(len(tracks))],
        parameter_paths=[simulated[:, i] for i in range(len(tracks))],
        seconds=seconds,
    )


def describe(
    identification: Identification, tracks: Sequence[Track], training: set[str]
) -> JsonTable:
    """Return parameters, posterior, coverage and undetermined directions for the results."""
    halves = {
        "training": [i for i, track in enumerate(tracks) if track.stem in training],
        "test": [i for i, track in enumerate(tracks) if track.stem not in training],
    }
    spread, sd = np.array(SPREAD), identification.vectors.std(axis=0)
    directions = identify.unidentified_directions(identification.information, N_DIRECTIONS)
    return {
        "parameters": {
            label: {
                "value": float(identification.vector[i] * spread[i]),
                "bootstrap_sd": float(sd[i] * spread[i]),
                "prior_sd": float(spread[i]),
            }
            for i, label in enumerate(LABELS)
        },
        "samples": (identification.vectors * spread).tolist(),
        "numbers": list_numbers(identification),
        "coverage": {
            name: {
                half: {
                    str(level): dict(
                        bands.coverage([tracks[i] for i in of], [paths[i] for i in of], level)
                    )
                    for level in bands.LEVELS
                }
                for half, of in halves.items()
            }
            for name, paths in (
                ("parameters_and_errors", identification.paths),
                ("parameters", identification.parameter_paths),
            )
        },
        "undetermined": [
            {"posterior_variance": variance, "direction": _name_direction(direction)}
            for variance, direction in directions
        ],
        "posterior_variances": [
            variance
            for variance, _ in identify.unidentified_directions(
                identification.information, len(LABELS)
            )
        ],
        "seconds": dict(identification.seconds),
    }


def list_numbers(identification: Identification) -> JsonTable:
    """Return physical numbers of the identified vehicle and their standard deviations.

    About the centre of mass of vehicle and extras; of the base without the arm, and the arm's.
    """
    source = build_campaign_vehicle(SOURCE_SET)

    def numbers(vector: jax.Array) -> dict[str, jax.Array]:
        vehicle = parameters.apply_parameters(source, vector)
        params, links = vehicle.params, vehicle.links
        return {
            "mass_kg": params.mass_kg,
            "inertia_kgm2": params.inertia_kgm2,
            "volume_m3": params.volume_m3,
            "center_of_buoyancy_m": params.p_cb_m,
            "added_mass": jnp.diag(params.M_A),
            "linear_damping": params.D_l,
            "quadratic_damping": params.D_q,
            "link_mass_kg": links.mass_kg,
            "joint_zero_rad": links.zero,
            "marker_yaw_rad": vehicle.marker_yaw_rad,
        }

    best = numbers(jnp.asarray(identification.vector))
    sampled = jax.vmap(numbers)(jnp.asarray(identification.vectors))
    return {
        name: {
            "value": np.asarray(value, float).tolist(),
            "sd": np.asarray(sampled[name], float).std(axis=0).tolist(),
        }
        for name, value in best.items()
    }


def _name_direction(direction: Array) -> dict[str, float]:
    """Return the components of a direction above a fifth, largest first."""
    order = np.argsort(-np.abs(direction))
    return {LABELS[i]: float(direction[i]) for i in order if abs(direction[i]) > 0.2}


def describe_runs(runs: Sequence[Run], tracks: Sequence[Track], training: set[str]) -> JsonTable:
    """Return what was judged and masked of each run."""
    by_stem = {track.stem: track for track in tracks}
    table: JsonTable = {}
    for run in runs:
        track = by_stem.get(run.stem)
        if track is None:
            table[run.stem] = {"copy_of": run.copy_of}
            continue
        table[run.stem] = {
            "half": "training" if run.stem in training else "test",
            "begin_s": float(track.t_s[0]),
            "end_s": float(track.t_s[-1]),
            **asdict(track.counts),
        }
    return table


def count_better(
    scores: Mapping[str, Mapping[str, RunScores]], training: set[str]
) -> dict[str, dict[str, int]]:
    """Return on how many test runs the identified set errs less than each other prediction."""
    if IDENTIFIED not in scores:
        return {}
    test = {stem: run for stem, run in scores[IDENTIFIED].items() if stem not in training}
    return {
        name: {
            "runs": len(test),
            "roll": sum(run["roll"] < of_runs[stem]["roll"] for stem, run in test.items()),
            "pitch": sum(run["pitch"] < of_runs[stem]["pitch"] for stem, run in test.items()),
            "heave": sum(run["heave"] < of_runs[stem]["heave"] for stem, run in test.items()),
        }
        for name, of_runs in scores.items()
        if name != IDENTIFIED
    }


def _describe_horizons(
    runs: Sequence[Run],
    tracks: Sequence[Track],
    training: set[str],
    vehicles: Mapping[str, CampaignVehicle],
) -> dict[str, object]:
    """Return errors after a few steps in windows of the test half."""
    by_stem = {run.stem: run for run in runs}
    judged = [track for track in tracks if track.stem not in training]
    windows = horizons.cut_windows([by_stem[track.stem] for track in judged], judged)
    return horizons.describe_horizons(windows, vehicles)


def format_results(results: Mapping[str, Mapping[str, object]]) -> str:
    """Return the results as JSON, an entry of each table a line, numbers with five digits."""
    tables = []
    for name, table in results.items():
        rows = [f"{json.dumps(key)}: {json.dumps(_tidy(entry))}" for key, entry in table.items()]
        tables.append(f"{json.dumps(name)}: {{\n  " + ",\n  ".join(rows) + "\n }")
    return "{\n " + ",\n ".join(tables) + "\n}\n"


def _tidy(value: object) -> object:
    """Return a value of JSON with five digits, and None for numbers that are not predicted."""
    if isinstance(value, dict):
        return {key: _tidy(entry) for key, entry in value.items()}
    if isinstance(value, list):
        return [_tidy(entry) for entry in value]
    if not isinstance(value, float):
        return value
    return None if math.isnan(value) else float(f"{value:.5g}")


def summarise(
    scores: Mapping[str, Mapping[str, RunScores]], training: set[str]
) -> dict[str, dict[str, dict[str, float]]]:
    """Return medians over all runs, the training half and the test half, by prediction."""
    halves: dict[str, Callable[[str], bool]] = {
        "all": lambda stem: True,
        "training": lambda stem: stem in training,
        "test": lambda stem: stem not in training,
    }
    return {
        half: {
            name: median_scores({stem: run for stem, run in of_runs.items() if belongs(stem)})
            for name, of_runs in scores.items()
        }
        for half, belongs in halves.items()
    }


def format_medians(medians: Mapping[str, Mapping[str, Mapping[str, float]]]) -> str:
    """Return medians of the test half as a table."""
    rows = [f"{'median over test runs':24s}   roll  pitch    yaw  heave  (rad, m)"]
    for name, scores in medians["test"].items():
        values = " ".join(f"{scores[key]:6.4f}" for key in ("roll", "pitch", "yaw", "heave"))
        rows.append(f"{name:24s} {values}")
    return "\n".join(rows)
