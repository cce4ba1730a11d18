"""Index of shards: read back as written, and damage of each kind detected."""

import numpy as np
import pytest

from angler_mjx.runs.storage import shards


def test_the_index_of_a_shard_says_where_chunks_lie_and_whether_it_is_whole(tmp_path):
    path = shards.locate_shard(tmp_path / "a", 3, 3)
    assert path == tmp_path / "a" / "c" / "3" / "0" / "0"
    assert shards.write_shard(path, [[b"one", b""], [b"three"]], shard=4) == 8 + 16 * 4 + 4
    whole = path.read_bytes()
    index = shards.read_index(whole[-68:], shard=4, file_bytes=len(whole))
    assert index[:3].tolist() == [[0, 3], [3, 0], [3, 5]]
    assert (index[3] == shards.ABSENT).all()
    assert shards.is_sound(path, shard=4)
    for damaged, reason in (
        (whole[1:], "chunks lie beyond its end"),
        (whole[:-1], "its index is wrong"),
        (whole[-67:], "its index is wrong"),
    ):
        path.write_bytes(damaged)
        assert not shards.is_sound(path, shard=4)
        with pytest.raises(ValueError, match=reason):
            shards.read_index(damaged[-68:], shard=4, file_bytes=len(damaged))
    path.write_bytes(b"more" + whole)
    assert not shards.is_sound(path, shard=4)


def test_a_shard_without_chunks_is_not_whole(tmp_path):
    path = tmp_path / "shard"
    shards.write_shard(path, [], shard=2)
    assert (np.frombuffer(path.read_bytes()[:-4], "<u8") == shards.ABSENT).all()
    assert not shards.is_sound(path, shard=2)
