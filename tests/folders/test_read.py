"""Folders of earlier versions are read by every command that reads such folders."""

import shlex
import shutil
import tarfile

import pytest

from tests.commands import running

from . import BESIDE, TABLE, write_inputs

ARCHIVES = sorted(BESIDE.glob("*.tar.xz"))


@pytest.fixture(scope="module", params=ARCHIVES, ids=lambda path: path.name.removesuffix(".tar.xz"))
def stored(request, tmp_path_factory):
    folder = tmp_path_factory.mktemp("stored")
    with tarfile.open(request.param) as archive:
        archive.extractall(folder, filter="data")
    write_inputs(folder)
    return folder


def test_there_are_folders():
    assert ARCHIVES


@pytest.mark.parametrize("row", TABLE["read"], ids=lambda row: row["line"])
def test_a_command_reads_a_folder(stored, tmp_path, row):
    folder = tmp_path / "copy"
    shutil.copytree(stored, folder)
    running.in_process(folder, shlex.split(row["line"]), set(row.get("codes", [0])))
