"""Images of programs: what they may hold, and what a program with one sees and may do."""

import io
import re
import shutil
import subprocess
import tarfile
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from angler_mjx.errors import UnsupportedError
from angler_mjx.leaderboard import checking, problem_files, program_images, sandbox
from angler_mjx.leaderboard.submission import ProgramConfig
from angler_mjx.leaderboard.submitted_plans import empty_rows
from angler_mjx.progress import Progress

from .submitting import run_command, write_card

NAME, OTHER = "open-still-known-01", "open-ocean-known-01"
SHORTEST = Path(__file__).parents[3] / "docs" / "examples" / "shortest.cpp"
try:
    sandbox.require_sandbox()
    REASON = ""
except UnsupportedError as error:
    REASON = str(error)
pytestmark = pytest.mark.skipif(bool(REASON), reason=REASON)

PROBE = r"""
#include <dirent.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>
int main(int count, char **words) {
  char text[4096] = "";
  if (!strcmp(words[1], "list")) {
    DIR *folder = opendir(words[2]);
    for (struct dirent *entry; folder && (entry = readdir(folder));)
      if (entry->d_name[0] != '.') strcat(strcat(text, entry->d_name), " ");
  }
  if (!strcmp(words[1], "read")) {
    FILE *file = fopen(words[2], "r");
    if (!file || !fgets(text, sizeof text, file)) strcpy(text, "cannot be read");
  }
  if (!strcmp(words[1], "write")) strcpy(text, fopen(words[2], "w") ? "written" : "cannot write");
  if (!strcmp(words[1], "variable")) strcpy(text, getenv(words[2]));
  if (!strcmp(words[1], "folder")) getcwd(text, sizeof text);
  if (!strcmp(words[1], "sleep")) sleep(60);
  if (!strcmp(words[1], "fork"))
    for (int i = 1; i < 100; i++) {
      int child = fork();
      if (child == 0) { sleep(60); return 0; }
      if (child < 0) { sprintf(text, "%d processes", i); break; }
    }
  fprintf(stderr, "%s\n", text);
  return 7;
}
"""


def build(folder, source, compiler, suffix):
    """Compile a static program, which runs in an image of nothing else."""
    if shutil.which(compiler) is None:
        pytest.skip(f"there is no compiler ({compiler})")
    path = folder / f"source.{suffix}"
    path.write_text(source)
    made = subprocess.run(
        [compiler, "-O1", "-static", "-o", folder / "program", path],
        capture_output=True,
        text=True,
        check=False,
    )
    if "cannot find -l" in made.stderr:
        pytest.skip(f"there are no static libraries for {compiler}")
    assert made.returncode == 0, made.stderr
    return (folder / "program").read_bytes()


@pytest.fixture(scope="module")
def probe(tmp_path_factory):
    return build(tmp_path_factory.mktemp("probe"), PROBE, "gcc", "c")


def write_image(path, entries):
    """Write a tar file of contents, or of what else `tarfile.TarInfo` describes, by name."""
    with tarfile.open(path, "w") as file:
        for name, content in entries.items():
            info = tarfile.TarInfo(name)
            data = content if isinstance(content, bytes) else b""
            info.mode, info.size = 0o700, len(data)
            for key, value in {} if isinstance(content, bytes) else content.items():
                setattr(info, key, value)
            file.addfile(info, io.BytesIO(data))


@contextmanager
def unpacked(folder, entries):
    if entries is not None:
        write_image(folder / "image.tar", entries)
    config = ProgramConfig(command=("/probe",), image="image.tar")
    with program_images.open_image(folder, config, Progress()) as image:
        yield image


@pytest.fixture
def run(tmp_path, probe):
    """Run the probe in an image with it and more; returns the text that it prints."""

    def run(*words, entries=None, **options):
        with unpacked(tmp_path, {"probe": probe, **(entries or {})}) as image:
            assert image.fault == ""
            return run_command("/probe", *words, image=image.root, **options)

    return run


LINK = {"type": tarfile.SYMTYPE}
FOLDER = {"type": tarfile.DIRTYPE}


def test_a_planner_in_an_image_plans_each_problem(tmp_path, problems, benchmark, sets, manifest):
    """It needs nothing but what the page says."""
    program = build(tmp_path, SHORTEST.read_text(), "g++", "cpp")
    entry, record = sets[NAME], manifest.find(NAME)
    scenario = problem_files.build_set_scenario(benchmark, entry, record.attempt, b"")
    config = ProgramConfig(command=("shortest",), image="image.tar")
    with unpacked(tmp_path, {"usr/bin/shortest": program}) as image:
        (tmp_path / "program").unlink()
        rows = sandbox.plan_set(
            tmp_path, config, entry, scenario, record, problems, 8.0, image.root
        )
    assert list(rows.faults) == ["", ""]
    for world in range(2):
        goal = (problems / f"{NAME}.zarr/team/goal_m/c/{world}/0/0").read_bytes()
        last = rows.arrays["points"][world, 0] - 1
        np.testing.assert_allclose(
            rows.arrays["position_m"][world, 0, last], np.frombuffer(goal, "<f4"), atol=1e-5
        )


def test_a_check_unpacks_an_image_once_for_all_sets(tmp_path, monkeypatch, manifest):
    source, roots = tmp_path / "s", []
    write_card(source, [NAME, OTHER], kind=('kind = "plans"', 'kind = "program"'))
    with (source / "card.toml").open("a") as file:
        file.write('[program]\ncommand = ["/a"]\nimage = "image.tar"\n')
    write_image(source / "image.tar", {"a": b"1"})

    def plan_set(*arguments):
        roots.append(arguments[-1])
        assert (arguments[-1] / "a").read_bytes() == b"1"
        return empty_rows(arguments[2], "late")

    monkeypatch.setattr(checking.graph_search, "measure_time_factor", lambda: 1.0)
    monkeypatch.setattr(sandbox, "plan_set", plan_set)
    assert checking.check_submission(source, tmp_path / "o", Progress(), manifest=manifest)
    assert len(roots) == 2
    assert len(set(roots)) == 1
    assert not roots[0].exists()


def test_a_program_sees_the_files_of_its_image_alone(run):
    entries = {"etc/os-release": b"an image", "proc": b"", "dev": LINK | {"linkname": "etc"}}
    entries |= {"out": LINK | {"linkname": "etc"}, "lib": LINK | {"linkname": "usr/lib"}}
    entries |= {"problem.zarr": b"of the image"}
    fault = run("list", "/", entries=entries)
    names = fault.removeprefix("ended with status 7: ").split()
    assert sorted(names) == ["dev", "etc", "lib", "out", "probe", "problem.zarr", "proc", "tmp"]
    assert "an image" in run("read", "/etc/os-release", entries=entries)
    assert "cannot be read" in run("read", "/usr/bin/env", entries=entries)
    assert "cannot be read" in run("read", "/etc/passwd", entries=entries)
    assert "null" in run("list", "/dev", entries=entries)


@pytest.mark.parametrize(
    ("path", "expected"),
    [
        ("/probe", "cannot write"),
        ("/x", "cannot write"),
        ("/etc/x", "cannot write"),
        ("/problem.zarr/x", "cannot write"),
        ("tmp/x", "written"),  # of the root, where it is called
        ("/dev/shm/x", "written"),
        ("/out/x", "written"),
    ],
)
def test_a_program_writes_where_others_do(run, path, expected):
    assert run("write", path, entries={"etc": FOLDER}) == f"ended with status 7: {expected}"


def test_the_working_directory_is_the_programs_folder_or_the_root(run):
    assert run("folder") == "ended with status 7: /"
    assert run("folder", with_program=True) == "ended with status 7: /program"


def test_limits_hold_with_an_image_too(run):
    assert run("sleep", limit_s=0.2) == "did not end within 0.2 s"
    count = re.fullmatch("ended with status 7: ([0-9]+) processes", run("fork", processes=4))
    assert 4 <= int(count[1]) <= 6


def test_variables_of_the_card_are_seen(run):
    assert run("variable", "PATH") == "ended with status 7: /usr/local/bin:/usr/bin:/bin"
    assert run("variable", "PATH", environment={"PATH": "/opt"}) == "ended with status 7: /opt"


def test_a_command_that_the_image_lacks_fails_with_the_reason(tmp_path):
    with unpacked(tmp_path, {"a": b""}) as image:
        assert "execvp /probe: No such file" in run_command("/probe", image=image.root)


def test_devices_are_skipped_and_rights_become_those_to_read(tmp_path):
    device = {"type": tarfile.CHRTYPE, "devmajor": 1, "devminor": 3}
    entries = {"dev/null": device, "etc/block": device | {"type": tarfile.BLKTYPE}, "last": b"1"}
    entries |= {"rights": {"mode": 0o6755}, "none": {"mode": 0}}
    entries |= {"folder": FOLDER | {"mode": 0o1700}, "folder/file": {"mode": 0o200}}
    with unpacked(tmp_path, entries) as image:
        assert image.fault == ""
        files = {str(path.relative_to(image.root)): path for path in image.root.rglob("*")}
        modes = {name: path.stat().st_mode & 0o7777 for name, path in files.items()}
    assert modes == {
        "dev": 0o755,
        "etc": 0o755,
        "last": 0o755,
        "rights": 0o755,
        "none": 0o644,
        "folder": 0o755,
        "folder/file": 0o644,
    }


@pytest.fixture
def aim():
    """Return a folder that any user may write, with a file that any may read."""
    with sandbox.open_scratch() as folder:
        folder.chmod(0o777)
        (folder / "secret").write_text("0123")
        yield folder


@pytest.mark.parametrize("kind", ["absolute", "parent", "link", "parent link", "hard link"])
def test_nothing_of_an_image_is_written_elsewhere(tmp_path, aim, kind):
    """Neither is anything of the judge read."""
    up = "../" * 20
    entries = {
        "absolute": {f"{aim}/file": b"1"},
        "parent": {f"{up}{aim}/file": b"1"},
        "link": {"link": LINK | {"linkname": str(aim)}, "link/file": b"1"},
        "parent link": {"link": LINK | {"linkname": f"{up}{aim}"}, "link/file": b"1"},
        "hard link": {"link": {"type": tarfile.LNKTYPE, "linkname": f"{aim}/secret"}},
    }
    with unpacked(tmp_path, entries[kind]) as image:
        assert [path.name for path in aim.iterdir()] == ["secret"]
        assert kind == "absolute" or "image.tar cannot be unpacked: ended with" in image.fault
        texts = [path.read_bytes() for path in image.root.rglob("*") if path.is_file()]
        assert b"0123" not in texts
        assert kind != "absolute" or (image.root / str(aim)[1:] / "file").read_bytes() == b"1"
    assert (aim / "secret").read_text() == "0123"


@pytest.mark.parametrize(
    ("content", "reason"),
    [
        (None, "image.tar is missing"),
        (b"", "image.tar cannot be unpacked: ended with status 1: tar: This does not look like"),
        (b"garbage" * 999, "ended with status 1: tar: This does not look like a tar archive"),
        (b"\x1f\x8b\x08" + bytes(9999), "Archive is compressed"),
    ],
    ids=["missing", "empty", "garbage", "compressed"],
)
def test_what_is_no_image_has_a_reason(tmp_path, content, reason):
    if content is not None:
        (tmp_path / "image.tar").write_bytes(content)
    with unpacked(tmp_path, None) as image:
        assert reason in image.fault


def test_an_image_that_is_cut_has_a_reason(tmp_path):
    write_image(tmp_path / "image.tar", {"a": bytes(99999)})
    whole = (tmp_path / "image.tar").read_bytes()
    (tmp_path / "image.tar").write_bytes(whole[:50000])
    with unpacked(tmp_path, None) as image:
        assert "Unexpected EOF" in image.fault


def test_an_image_that_is_too_large_has_a_reason(tmp_path, monkeypatch):
    entries = {"a/b/c": b"", "d": bytes(3 << 20)}
    monkeypatch.setattr(program_images, "MAX_FILES", 4)
    with unpacked(tmp_path, entries) as image:
        assert image.fault == ""
    monkeypatch.setattr(program_images, "MAX_FILES", 3)
    with unpacked(tmp_path, entries) as image:
        assert image.fault.startswith("image.tar cannot be unpacked: wrote more than 3 files or ")
    monkeypatch.setattr(program_images, "MAX_BYTES", 2 << 20)
    with unpacked(tmp_path, entries) as image:
        assert image.fault == "image.tar has more than 2 MiB"


def test_a_root_of_too_many_entries_has_a_reason(tmp_path):
    with unpacked(tmp_path, {f"{i}": b"" for i in range(101)}) as image:
        assert image.fault == "image.tar has more than 100 entries in its root"


def test_unpacking_has_a_time_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(program_images, "LIMIT_S", 0.2)
    monkeypatch.setattr(program_images, "_UNPACK", "sleep 60")
    with unpacked(tmp_path, {"a": b""}) as image:
        assert image.fault == "image.tar cannot be unpacked: did not end within 0.2 s"


def test_a_disk_that_is_too_small_is_the_judges_fault(tmp_path, monkeypatch):
    usage = shutil.disk_usage(tmp_path)._replace(free=100)
    monkeypatch.setattr(shutil, "disk_usage", lambda _: usage)
    with pytest.raises(UnsupportedError, match="set TMPDIR"), unpacked(tmp_path, {"a": b""}):
        pass


def test_an_interrupt_deletes_what_was_unpacked(tmp_path):
    roots = []

    def interrupt():
        with unpacked(tmp_path, {"a": b"1"}) as image:
            roots.append(image.root)
            assert (image.root / "a").read_bytes() == b"1"
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupt()
    assert not roots[0].parent.exists()
