"""Writing one shard of a Zarr v3 array in one go.

A shard file holds the chunks one after another, then an index of uint64 pairs (offset, length) and
the CRC-32C of the index (Zarr v3, codec ``sharding_indexed``). Zarr's own writer treats every chunk
by itself in one thread, four times slower; a whole shard takes a few lines here, and Zarr
reads it like any other.
"""

import os
from collections.abc import Iterable
from pathlib import Path

import google_crc32c
import numpy as np
from numcodecs.blosc import Blosc

ABSENT = np.uint64(2**64 - 1)
"""Offset and length of a chunk that is not there."""


def write(path: Path, values: np.ndarray, *, shard: int, codec: Blosc | None) -> int:
    """Write a shard whose chunks hold one element of the leading axis each.

    Args:
        path: of the shard's file; its folder is made if need be.
        values: [n, ...] with n up to ``shard``; what is missing at the end is left out.
        shard: chunks in a shard.
        codec: that compresses each chunk; none if None.

    Returns:
        Bytes written.

    Raises:
        OSError: it cannot be written; nothing of that name is left then.
    """
    values = np.ascontiguousarray(values)
    count = len(values)
    index = np.full((shard, 2), ABSENT, "<u8")
    chunks: Iterable[bytes | memoryview]
    if codec is None:
        size = values.nbytes // max(count, 1)
        lengths = np.full(count, size, np.uint64)
        chunks = [memoryview(values).cast("B")]
    else:
        chunks = _compressed(values, codec)
        lengths = np.array([len(chunk) for chunk in chunks], np.uint64)
    index[:count, 0] = np.concatenate([[0], np.cumsum(lengths)[:-1]]) if count else 0
    index[:count, 1] = lengths
    tail = index.tobytes()
    tail += google_crc32c.value(tail).to_bytes(4, "little")
    path.parent.mkdir(parents=True, exist_ok=True)
    unfinished = path.with_name(f".{path.name}.unfinished")
    try:
        with unfinished.open("wb", buffering=0) as file:
            for chunk in (*chunks, tail):
                _write_all(file.fileno(), memoryview(chunk))
        unfinished.replace(path)
    except OSError:
        unfinished.unlink(missing_ok=True)
        raise
    return int(lengths.sum()) + len(tail)


def _compressed(values: np.ndarray, codec: Blosc) -> list[bytes]:
    # Blosc takes the size of an element from the array, and lets other threads run meanwhile.
    return [codec.encode(value) for value in values]


def _write_all(file: int, data: memoryview) -> None:
    """Write all of it: one call takes 2 GB at most, and less when the disk is nearly full."""
    while data.nbytes:
        data = data[os.write(file, data) :]
