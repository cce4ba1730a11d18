"""The release: versions that disagree, unclean checkouts and unwanted contents are refused."""

import hashlib
import io
import re
import shutil
import subprocess
import sys
import tarfile
import tomllib
import zipfile
from pathlib import Path

import pytest

from angler_mjx.cli import main as cli
from tools.release import __main__ as release
from tools.release import contents, trial, versions
from tools.release.processes import ReleaseError, clean_environment, run_process

ROOT = Path(__file__).parents[2]
FILES = (
    "CHANGELOG.md",
    "CITATION.cff",
    ".zenodo.json",
    "Containerfile",
    "README.md",
    "pyproject.toml",
    "experiments/pyproject.toml",
    "angler_mjx/_version.py",
    "docs/how_to/install.md",
)
RC = versions.read_version(ROOT)
DATE = re.search(rf"^## \[{re.escape(RC)}\] - (\S+)$", (ROOT / "CHANGELOG.md").read_text(), re.M)[1]


@pytest.fixture
def tree(tmp_path):
    """Copy of the files that name the version."""
    for name in FILES:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy(ROOT / name, tmp_path / name)
    return tmp_path


@pytest.fixture
def repository(tree):
    for words in (
        ("init", "-q"),
        ("config", "user.name", "a"),
        ("config", "user.email", "a@b.c"),
        ("add", "-A"),
        ("commit", "-q", "-m", "first", "--date", "2026-01-02T03:04:05Z"),
    ):
        subprocess.run(["git", "-C", str(tree), *words], check=True)
    return tree


def test_the_version_of_this_checkout_is_the_same_everywhere():
    sections = re.findall(r"^## \[(.*?)\]", (ROOT / "CHANGELOG.md").read_text(), re.M)
    version = sections[1] if sections[0] == "Unreleased" else sections[0]
    assert versions.read_version(ROOT) == version
    faults = [x for x in versions.find_version_faults(ROOT) if "[Unreleased] lists" not in x]
    assert faults == []


@pytest.mark.parametrize(
    ("file", "before", "after", "fault"),
    [
        ("angler_mjx/_version.py", RC, "9.0.0", "CHANGELOG.md: no section [9.0.0]"),
        ("CHANGELOG.md", f"## [{RC}] - {DATE}", f"## [{RC}]", "has no date"),
        ("CHANGELOG.md", "## [Unreleased]", "## [9.0.0] - 2026-12-24\n\n- x\n", "not the newest"),
        (
            "CHANGELOG.md",
            "## [Unreleased]\n",
            "## [Unreleased]\n\n- Later.\n",
            "[Unreleased] lists changes",
        ),
        ("CHANGELOG.md", f"[{RC}] - {DATE}\n", f"[{RC}] - {DATE}\n\n## [0]\n", "nothing"),
        ("CITATION.cff", RC, "9.0.0", f"CITATION.cff: version is 9.0.0, not {RC}"),
        ("CITATION.cff", DATE, "2025-01-02", "CITATION.cff: date is 2025-01-02"),
        (".zenodo.json", RC, "0.2.0", ".zenodo.json: version is 0.2.0"),
        (".zenodo.json", DATE, "", ".zenodo.json: date is missing"),
        (
            "pyproject.toml",
            "dynamic =",
            'version = "1"\ndynamic =',
            "pyproject.toml: has a version",
        ),
        (
            "experiments/pyproject.toml",
            "dynamic =",
            'version = "1"\ndynamic =',
            "experiments/pyproject.toml: has a version",
        ),
        (
            "docs/how_to/install.md",
            f"angler_mjx-{RC}-py3",
            "angler_mjx-0.2.0-py3",
            "docs/how_to/install.md: names 0.2.0",
        ),
    ],
)
def test_a_place_that_disagrees_is_named(tree, file, before, after, fault):
    text = (tree / file).read_text()
    assert before in text
    (tree / file).write_text(text.replace(before, after, 1))
    faults = versions.find_version_faults(tree)
    assert any(fault in line for line in faults), faults


@pytest.mark.parametrize("text", ["", '__version__ = "1.0"\n', '__version__ = "v1.0.0"\n'])
def test_a_version_that_is_none_is_refused(tree, text):
    (tree / "angler_mjx" / "_version.py").write_text(text)
    with pytest.raises(ReleaseError, match=r"_version\.py"):
        versions.read_version(tree)


def test_fields_of_the_owners_are_listed_until_they_are_filled_in(tree):
    shutil.copy(ROOT / "paper.md", tree)
    everywhere = versions.find_owner_fields(tree)
    assert set(everywhere) >= {"CITATION.cff", ".zenodo.json", "pyproject.toml"}
    text = (tree / ".zenodo.json").read_text()
    (tree / ".zenodo.json").write_text(text.replace("TO BE FILLED IN BY THE OWNER", ""))
    assert ".zenodo.json" not in versions.find_owner_fields(tree)


def test_a_clean_checkout_gives_commit_and_time(repository):
    commit, seconds = versions.read_commit(repository, RC)
    asked = ["git", "-C", str(repository), "show", "-s", "--format=%H,%ct"]
    shown = subprocess.run(asked, capture_output=True, text=True, check=True).stdout.strip()
    assert f"{commit},{seconds}" == shown


@pytest.mark.parametrize("name", ["README.md", "new.txt"], ids=["changed", "untracked"])
def test_an_unclean_checkout_is_refused(repository, name):
    with (repository / name).open("a") as file:
        file.write("more\n")
    with pytest.raises(ReleaseError, match=name):
        versions.read_commit(repository, RC)


def test_a_folder_without_a_repository_is_refused(tree):
    with pytest.raises(ReleaseError, match="not a git repository"):
        versions.read_commit(tree, RC)


@pytest.mark.parametrize("annotated", [False, True])
def test_a_tag_of_another_commit_is_refused(repository, annotated):
    tag = ["git", "-C", str(repository), "tag", f"v{RC}", *(["-m", "x"] if annotated else [])]
    subprocess.run(tag, check=True)
    versions.read_commit(repository, RC)
    more = ["git", "-C", str(repository), "commit", "-q", "--allow-empty", "-m", "second"]
    subprocess.run(more, check=True)
    with pytest.raises(ReleaseError, match="tag of another commit"):
        versions.read_commit(repository, RC)


@pytest.mark.parametrize(
    ("change", "printed"),
    [
        (lambda tree: (tree / "new.txt").write_text(""), "new.txt"),
        (lambda tree: (tree / "CHANGELOG.md").write_text("# Changelog\n"), f"no section [{RC}]"),
    ],
    ids=["unclean", "no section"],
)
def test_the_command_refuses(repository, monkeypatch, capsys, change, printed):
    monkeypatch.setattr(release, "ROOT", repository)
    shutil.copy(ROOT / "paper.md", repository.parent / "paper.md")
    change(repository)
    assert release.main(release.ReleaseOptions(check=True)) == 1
    assert printed in capsys.readouterr().err


@pytest.mark.parametrize(
    ("name", "content", "fault"),
    [
        ("a.txt", b"see /%s/jane/angler" % b"home", "a path of a machine"),
        ("a.txt", b"see /%s/jane/x" % b"Users", "a path of a machine"),
        ("a.txt", b"see /checkout/of/mine/x", "a path of a machine"),
        ("a.txt", b"--index-%s https://x.y/z" % b"url", "an index"),
        ("pip.conf", b"extra-index-%s = http://x.y" % b"url", "an index"),
        ("a.txt", b"url https%s" % b"://user:word@x.y", "an index"),
        ("a.txt", b'"https://x.y/%s"' % b"simple", "an index"),
        ("a/__pycache__/b.txt", b"", "not wanted"),
        ("a.pyc", b"", "not wanted"),
        ("../a", b"", "not wanted"),
        ("/a", b"", "not wanted"),
        ("a.bin", b"\0" * 5_000_000, "5,000,000 bytes"),
    ],
)
def test_unwanted_contents_are_found(name, content, fault):
    (found,) = contents.find_content_faults({name: content}, paths=["/checkout/of/mine/"])
    assert fault in found


def test_ordinary_contents_have_no_faults():
    members = {"a.py": b"pip install angler-mjx; a/simple/path; https://x.y/", "b/c.toml": b""}
    assert contents.find_content_faults(members, paths=["/x/"], tracked=["a.py"]) == []
    missing = contents.find_content_faults(members, paths=["/x/"], tracked=["a.py", "d.py"])
    assert missing == ["d.py: of the commit, and missing"]


def test_this_checkout_has_contents_of_a_release():
    listed = subprocess.run(
        ["git", "-C", str(ROOT), "ls-files", "-z"], capture_output=True, text=True, check=False
    )
    if listed.returncode:
        pytest.skip("not a git checkout")
    paths = [ROOT / name for name in listed.stdout.split("\0") if name and (ROOT / name).is_file()]
    members = {str(path.relative_to(ROOT)): path.read_bytes() for path in paths}
    assert len(members) > 1000
    assert contents.find_content_faults(members, paths=[f"{ROOT}/"]) == []


def test_members_of_both_kinds_are_read(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.whl", "w") as wheel:
        wheel.writestr("a/b.py", "x")
    with tarfile.open(tmp_path / "a.tar.gz", "w:gz") as archive:
        member = tarfile.TarInfo("a-1/a/b.py")
        member.size = 1
        archive.addfile(member, io.BytesIO(b"x"))
    for name in ("a.whl", "a.tar.gz"):
        assert contents.read_members(tmp_path / name) == {"a/b.py": b"x"}


def test_the_trial_runs_what_the_readme_prints():
    commands = trial.read_first_commands((ROOT / "README.md").read_text())
    assert commands == ["angler rollout reef_fleet --worlds 16 --out runs/first"]
    assert {line.split()[1] for line in trial.MORE_COMMANDS} <= set(cli.COMMANDS)
    with pytest.raises(ReleaseError, match="Install"):
        trial.read_first_commands("# x\n\n## Install\n\n```sh\nmake venv\n```\n")


def test_a_process_gets_nothing_of_this_checkout(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    monkeypatch.setenv("XLA_FLAGS", "--x")
    monkeypatch.setenv("PIP_CERT", "/a/certificate")
    environment = clean_environment(tmp_path / "home")
    assert environment["PIP_CERT"] == "/a/certificate"
    assert not {"PYTHONPATH", "XLA_FLAGS"} & set(environment)
    script = "import os; print(os.environ['HOME'])"
    done = run_process([sys.executable, "-c", script], tmp_path, environment)
    assert done.output.strip() == str(tmp_path / "home")


def test_seconds_are_those_of_the_clock_and_of_processors(tmp_path):
    script = "import time\ntime.sleep(1)\nwhile time.process_time() < 0.5: pass"
    done = run_process([sys.executable, "-c", script], tmp_path, clean_environment(tmp_path / "h"))
    assert done.seconds > 1.4
    assert 0.5 <= done.cpu_seconds < 1.4


def test_a_failed_process_is_reported_with_its_output(tmp_path):
    words = [sys.executable, "-c", "import sys; print('why'); sys.exit(3)"]
    with pytest.raises(ReleaseError, match=r"exit status 3\nwhy"):
        run_process(words, tmp_path, clean_environment(tmp_path / "home"))
    with pytest.raises(ReleaseError, match="No such file"):
        run_process(["no-such-program"], tmp_path, clean_environment(tmp_path / "home"))


def test_sums_are_those_that_sha256sum_reads(tmp_path):
    (tmp_path / "a.txt").write_bytes(b"x")
    release._write_sums(tmp_path)
    digest = hashlib.sha256(b"x").hexdigest()
    assert (tmp_path / "SHA256SUMS").read_text() == f"{digest}  a.txt\n"
    subprocess.run(["sha256sum", "-c", "--quiet", "SHA256SUMS"], cwd=tmp_path, check=True)


def test_a_release_holds_the_files_that_install_names():
    """Beside what is built: an image is made from the folder of a release alone."""
    text = (ROOT / "docs" / "how_to" / "install.md").read_text(encoding="utf-8")
    listed = re.search(r"^A release is a folder of (.*?)\. Python", text, re.M | re.S)[1]
    named = set(re.findall(r"`([\w.]+)`", listed))
    assert named == {*release.COPIED, release.BILL, release.SUMS}
    assert all((ROOT / name).is_file() for name in release.COPIED)
    files = set(re.findall(r"podman build --file (\S+)", text))
    assert {name.removeprefix("dist/") for name in files} <= set(release.COPIED)
    assert all(name.startswith("dist/") for name in files)


def test_the_tools_of_a_release_are_pinned():
    text = (ROOT / "tools" / "release" / "requirements.txt").read_text()
    pins = [line for line in text.splitlines() if not line.startswith("#")]
    assert all(re.fullmatch(r"[A-Za-z0-9._-]+==[\w.]+", line) for line in pins)
    needed = {"twine", "cyclonedx-bom", "hatchling"}
    assert needed <= {line.partition("==")[0] for line in pins}
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["build-system"]["requires"] == ["hatchling>=1.27"]
