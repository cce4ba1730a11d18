"""Minari dataset, written by Minari itself: one robot's flight per episode.

Minari requires one observation more than actions: the last sample has no action.
"""

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from itertools import batched
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from angler_mjx import __version__
from angler_mjx.errors import UnsupportedError
from angler_mjx.learning.datasets.dataset import Dataset
from angler_mjx.learning.datasets.exports import flights

if TYPE_CHECKING:
    from minari import MinariDataset
    from minari.data_collector import EpisodeBuffer

FOLDER_VARIABLE = "MINARI_DATASETS_PATH"
BUFFER_SIZE = 200
"""Number of flights that are passed to Minari at once."""


def write_dataset(data: Dataset, out: Path, action: str, progress: Callable[[int], None]) -> None:
    """Write ``angler/NAME-v0`` below a folder, to be named by ``MINARI_DATASETS_PATH``.

    Arguments and errors as of `parquet.write_dataset`.

    Raises:
        UnsupportedError: Minari is not installed.
    """
    try:
        import minari
        from gymnasium import spaces
        from minari.data_collector import EpisodeBuffer
    except ImportError as error:
        raise UnsupportedError(
            "Minari is not installed: pip install 'angler-mjx[export]'"
        ) from error
    width = len(flights.action_names(data, action))
    others = int(data.robots.max()) - 1
    observation_size = len(flights.STATE_COLUMNS) + others * len(flights.OTHER_COLUMNS)
    unbounded = partial(spaces.Box, low=-np.inf, high=np.inf, dtype=np.float32)
    description = {
        "dataset_id": f"angler/{re.sub('[^a-z0-9]+', '-', data.root.name.lower())}-v0",
        "observation_space": unbounded(shape=(observation_size,)),
        "action_space": unbounded(shape=(width,)),
        "description": json.dumps(flights.describe_columns(data, action)),
        "algorithm_name": ", ".join(sorted(set(data.index["expert"].to_pylist()))),
        "requirements": [f"angler-mjx=={__version__}"],
    }
    before = os.environ.get(FOLDER_VARIABLE)
    os.environ[FOLDER_VARIABLE] = str(out)  # Minari has no other interface for it
    try:
        _write_buffers(
            minari.create_dataset_from_buffers,
            _build_buffers(data, action, EpisodeBuffer, progress),
            description,
        )
    finally:
        if before is None:
            del os.environ[FOLDER_VARIABLE]
        else:
            os.environ[FOLDER_VARIABLE] = before


def _write_buffers(
    create_dataset: "Callable[..., MinariDataset]",
    episodes: "Iterator[EpisodeBuffer]",
    description: Mapping[str, object],
) -> None:
    dataset = None
    for group in batched(episodes, BUFFER_SIZE):
        if dataset is None:
            dataset = create_dataset(buffer=list(group), **description)
        else:
            dataset.update_dataset_from_buffer(list(group))


def _build_buffers(
    data: Dataset,
    action: str,
    buffer_class: "type[EpisodeBuffer]",
    progress: Callable[[int], None],
) -> "Iterator[EpisodeBuffer]":
    """Yield flights as Minari's buffers.

    Flights of a single sample have no action and are left out.
    """
    number = 0
    for count, flight in enumerate(flights.iterate_flights(data, action), 1):
        progress(count)
        steps = len(flight.time_s)
        if steps < 2:
            continue
        is_last = np.zeros(steps - 1, bool)
        is_last[-1] = True
        timed_out = flight.outcome == "timeout"
        yield buffer_class(
            id=number,
            options={"split": flight.split, "outcome": flight.outcome, "robot": flight.robot},
            observations=np.concatenate([flight.state, flight.others.reshape(steps, -1)], axis=1),
            actions=flight.action[:-1],
            rewards=(is_last * flight.arrived).astype(np.float32),
            terminations=is_last & (not timed_out),
            truncations=is_last & timed_out,
            infos={},
        )
        number += 1
