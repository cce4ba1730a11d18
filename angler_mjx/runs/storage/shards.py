"""Files of a Zarr v3 array, written at once and read by their index: a chunk, or a shard of many.

A shard file holds the chunks one after another, then an index of uint64 pairs (offset, length) and
the CRC-32C of the index (Zarr v3, codec ``sharding_indexed``). Zarr's own writer treats every chunk
by itself in one thread, four times slower, and takes 2 ms of Python for the smallest array; a
whole file takes a few lines here, and Zarr reads it like any other.
"""

import os
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

import google_crc32c
import numpy as np

from angler_mjx.runs.storage import atomic_files

ABSENT = np.uint64(2**64 - 1)
"""Offset and length of a chunk that is not there."""


def write_shard(path: Path, blocks: Iterable[Sequence[bytes]], *, shard: int) -> int:
    """Write a shard, its chunks in the order in which they come.

    Args:
        path: of the shard's file; its folder is made if need be.
        blocks: encoded chunks, some at a time, up to ``shard`` in all; what is missing at the end
            is left out.
        shard: chunks in a shard.

    Returns:
        Bytes written.

    Raises:
        OSError: it cannot be written; nothing of that name is left then.
    """
    lengths: list[int] = []

    def shard_pieces() -> Iterator[bytes]:
        for block in blocks:
            lengths.extend(map(len, block))
            yield b"".join(block)  # a copy costs less than a call for each chunk
        yield _build_index(lengths, shard)

    return write_file(path, shard_pieces())


def write_file(path: Path, pieces: Iterable[bytes]) -> int:
    """Write a file of pieces, one after another.

    Args:
        path: of the file; its folder is made if need be.
        pieces: as they come; the disk begins with each at once, and is not waited for.

    Returns:
        Bytes written.

    Raises:
        OSError: it cannot be written; nothing of that name is left then.
    """
    path.parent.mkdir(parents=True, exist_ok=True)
    written = 0
    with (
        atomic_files.write_atomically(path, durable=False) as writing,
        writing.open("wb", buffering=0) as file,
    ):
        for piece in pieces:
            _write_all(file.fileno(), memoryview(piece))
            start_writeback(file.fileno(), written, len(piece))
            written += len(piece)
    return written


def locate_shard(array: Path, number: int, ndim: int) -> Path:
    """Return the file of a shard, or of a chunk; only the first of an array's axes is divided."""
    return array / "c" / "/".join([str(number), *"0" * (ndim - 1)])


def read_index(tail: bytes, *, shard: int, file_bytes: int) -> np.ndarray:
    """Return the index of a shard: offset and length of each chunk, uint64 [shard, 2], bytes.

    Args:
        tail: the last `index_bytes` of the file.
        shard: chunks in a shard.
        file_bytes: length of the file.

    Raises:
        ValueError: the file was cut, or its index is damaged.
    """
    if len(tail) != index_bytes(shard) or google_crc32c.value(tail[:-4]) != int.from_bytes(
        tail[-4:], "little"
    ):
        raise ValueError("its index is wrong")
    index = np.frombuffer(tail[:-4], "<u8").reshape(shard, 2)
    if _data_bytes(index) > file_bytes - len(tail):
        raise ValueError("chunks lie beyond its end")
    return index


def index_bytes(shard: int) -> int:
    """Return the length of the index of a shard of so many chunks, bytes."""
    return 16 * shard + 4


def is_sound(path: Path, *, shard: int | None) -> bool:
    """Return whether a file is present with the length that its index gives.

    Args:
        path: of the file.
        shard: chunks in it; None for a single chunk, compressed by Blosc.
    """
    try:
        with path.open("rb") as file:
            size = path.stat().st_size
            if shard is None:  # Blosc's header ends with the whole length
                head = file.read(16)
                return len(head) == 16 and int.from_bytes(head[12:], "little") == size
            data_bytes = size - index_bytes(shard)
            file.seek(data_bytes)
            index = read_index(file.read(), shard=shard, file_bytes=size)
    except (OSError, ValueError):
        return False
    return _data_bytes(index) == data_bytes > 0


def _data_bytes(index: np.ndarray) -> int:
    """Return the end of the last chunk of a shard, bytes; 0 where there is none."""
    present = index[index[:, 0] != ABSENT]
    return int(present.sum(axis=1).max(initial=0))


def _build_index(lengths: list[int], shard: int) -> bytes:
    """Build the index of a shard: offset and length of each chunk, and their checksum."""
    index = np.full((shard, 2), ABSENT, "<u8")
    ends = np.cumsum(lengths, dtype=np.uint64)
    index[: len(lengths), 0] = ends - np.array(lengths, np.uint64)
    index[: len(lengths), 1] = lengths
    tail = index.tobytes()
    check: int = google_crc32c.value(tail)
    return tail + check.to_bytes(4, "little")


def start_writeback(file: int, offset: int, length: int) -> None:
    """Start writing to disk now; by default Linux waits 30 s or until much is unwritten.

    Only with the part that is new: each call goes through all pages of the part that it names.
    """
    if hasattr(os, "posix_fadvise"):
        os.posix_fadvise(file, offset, length, os.POSIX_FADV_DONTNEED)


def _write_all(file: int, data: memoryview) -> None:
    """Write all of it: one call takes 2 GB at most, and less when the disk is nearly full."""
    while data.nbytes:
        data = data[os.write(file, data) :]
