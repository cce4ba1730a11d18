"""Flights as a Minari dataset, written by Minari itself: an episode a robot's flight.

There is one observation more than there are actions, as Minari has it: the last sample has none.
"""

import json
import os
import re
from collections.abc import Callable, Iterator, Mapping
from itertools import batched
from pathlib import Path
from typing import Any

import numpy as np

from angler_mjx import __version__
from angler_mjx.errors import UnsupportedError
from angler_mjx.learning.datasets.exports import flights
from angler_mjx.learning.datasets.reading.dataset import Dataset

FOLDER = "MINARI_DATASETS_PATH"
BUFFER = 200
"""Flights that are handed over at once."""


def write(data: Dataset, out: Path, action: str, tell: Callable[[int], None]) -> None:
    """Write ``angler/NAME-v0`` below a folder, which ``MINARI_DATASETS_PATH`` then names.

    Arguments and errors as of `parquet.write`.

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
    seen = len(flights.STATE) + others * len(flights.OTHER)
    unbounded: dict[str, Any] = {"low": -np.inf, "high": np.inf, "dtype": np.float32}
    about = {
        "dataset_id": f"angler/{re.sub('[^a-z0-9]+', '-', data.place.name.lower())}-v0",
        "observation_space": spaces.Box(shape=(seen,), **unbounded),
        "action_space": spaces.Box(shape=(width,), **unbounded),
        "description": json.dumps(flights.about(data, action)),
        "algorithm_name": ", ".join(sorted(set(data.index["expert"].to_pylist()))),
        "requirements": [f"angler-mjx=={__version__}"],
    }
    before = os.environ.get(FOLDER)
    os.environ[FOLDER] = str(out)  # Minari knows no other way to be told
    try:
        _write(minari, _episodes(data, action, EpisodeBuffer, tell), about)
    finally:
        if before is None:
            del os.environ[FOLDER]
        else:
            os.environ[FOLDER] = before


def _write(minari: Any, episodes: Iterator[Any], about: Mapping[str, Any]) -> None:
    made = None
    for group in batched(episodes, BUFFER):
        if made is None:
            made = minari.create_dataset_from_buffers(buffer=list(group), **about)
        else:
            made.update_dataset_from_buffer(list(group))


def _episodes(data: Dataset, action: str, kind: Any, tell: Callable[[int], None]) -> Iterator[Any]:
    """Flights as Minari's buffers; those of a single sample, in which nothing is done, left out."""
    number = 0
    for count, flight in enumerate(flights.flights(data, action), 1):
        tell(count)
        steps = len(flight.time_s)
        if steps < 2:
            continue
        last = np.zeros(steps - 1, bool)
        last[-1] = True
        late = flight.outcome == "timeout"
        yield kind(
            id=number,
            options={"split": flight.split, "outcome": flight.outcome, "robot": flight.robot},
            observations=np.concatenate([flight.state, flight.others.reshape(steps, -1)], axis=1),
            actions=flight.action[:-1],
            rewards=(last * flight.arrived).astype(np.float32),
            terminations=last & (not late),
            truncations=last & late,
            infos={},
        )
        number += 1
