"""Files recognised by their checksums: one, a folder, and differences by name."""

import hashlib

import pytest

from angler_mjx.runs.storage import checksums, output_lock


def make_folder(root):
    (root / "a").mkdir()
    for name in ("a/one", "two", "a.b", output_lock.LOCK):
        (root / name).write_text(name)
    return root


def test_a_folder_lists_and_hashes_all_files_but_its_lock(tmp_path):
    root = make_folder(tmp_path)
    names = checksums.list_files(root)
    assert names == ["a.b", "a/one", "two"]
    digests = dict(checksums.hash_files(root, names))
    assert digests == {name: hashlib.sha256(name.encode()).hexdigest() for name in names}
    before = checksums.hash_folder(root)
    (root / output_lock.LOCK).unlink()
    assert checksums.hash_folder(root) == before
    (root / "two").rename(root / "three")
    assert checksums.hash_folder(root) != before


def test_differences_are_named(tmp_path):
    root = make_folder(tmp_path)
    digests = dict(checksums.hash_files(root, checksums.list_files(root)))
    (root / "two").write_text("changed")
    (root / "a.b").rename(root / "new")
    found = checksums.compare_files(root, digests, checksums.list_files(root))
    assert (found.missing, found.changed, found.foreign) == (("a.b",), ("two",), ("new",))
    assert found.compared == 2


@pytest.mark.parametrize(
    ("name", "inside"),
    [("a/b", True), ("../a", False), ("a/../../b", False), ("/etc", False), ("", False)],
)
def test_paths_that_leave_a_folder_are_told(name, inside):
    assert checksums.is_inside(name) is inside
