"""Files of a cache: whole, absent, or damaged."""

import threading

import pytest

from angler_kernels.checked_file import read_checked, write_checked

CONTENT = bytes(range(256)) * 40


def test_content_is_read_as_it_was_written(tmp_path):
    path = tmp_path / "of" / "a cache" / "file"
    assert write_checked(path, CONTENT)
    assert read_checked(path) == CONTENT
    assert write_checked(path, b"")
    assert read_checked(path) == b""
    assert [item.name for item in path.parent.iterdir()] == ["file"]


@pytest.mark.parametrize(
    "damage", [lambda x: x[:-1], lambda x: x[:20], lambda x: b"", lambda x: x + b"0"]
)
def test_a_damaged_file_is_not_read(tmp_path, damage):
    path = tmp_path / "file"
    write_checked(path, CONTENT)
    path.write_bytes(damage(path.read_bytes()))
    assert read_checked(path) is None
    assert write_checked(path, CONTENT)
    assert read_checked(path) == CONTENT


def test_one_changed_byte_is_seen_wherever_it_is(tmp_path):
    path = tmp_path / "file"
    write_checked(path, b"abc")
    whole = path.read_bytes()
    for i in range(len(whole)):
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :])
        assert read_checked(path) is None


def test_a_folder_that_cannot_be_written_holds_nothing(tmp_path):
    taken = tmp_path / "file"
    taken.write_text("not a folder")
    assert not write_checked(taken / "program", CONTENT)
    assert read_checked(taken / "program") is None
    (tmp_path / "folder").mkdir()
    assert not write_checked(tmp_path / "folder", CONTENT)
    assert sorted(item.name for item in tmp_path.iterdir()) == ["file", "folder"]


def test_two_writers_leave_a_whole_file(tmp_path):
    path, seen = tmp_path / "file", []
    contents = [bytes([i]) * 100_000 for i in range(2)]
    done = threading.Event()

    def write(content):
        for _ in range(30):
            write_checked(path, content)

    def read():
        while not done.is_set():
            seen.append(read_checked(path))

    write(contents[0])
    writers = [threading.Thread(target=write, args=(content,)) for content in contents]
    reader = threading.Thread(target=read)
    for thread in (reader, *writers):
        thread.start()
    for thread in writers:
        thread.join()
    done.set()
    reader.join()
    assert seen
    assert set(seen) <= set(contents)
