"""Getting an ArduSub: over HTTP with all that goes wrong there, from a file, and which one is run.

What is fetched is a small program of this machine; whether it acts like an ArduSub is looked at
with the real one only.
"""

import hashlib
import shutil
import socket
import struct
from pathlib import Path

import pytest

from angler_mjx.cli.main import main
from angler_mjx.errors import ConfigError, RunError
from angler_sitl.firmware import binary, install
from angler_sitl.firmware.probe import ProbeResult

from .file_server import Server

PROGRAM = Path(shutil.which("true")).read_bytes()


@pytest.fixture
def server():
    given = Server(PROGRAM)
    yield given
    given.close()


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.delenv(binary.ENVIRONMENT_VARIABLE, raising=False)
    return binary.cache_folder()


@pytest.fixture
def says(monkeypatch):
    """What the program says of itself; a list whose first is what it says."""
    said = ["4.5.3"]
    monkeypatch.setattr(
        install,
        "_probe_version",
        lambda *_: ProbeResult(version=said[0], git="abcdef12", parameters={}, sysid=1),
    )
    return said


def nothing(*_):
    pass


def fetched(server, **given):
    return install.install_from_network("stable-4.5.3", server.url, nothing, **given)


def complaint(do, *given, error=ConfigError, **more):
    with pytest.raises(error) as caught:
        do(*given, **more)
    return str(caught.value)


def test_fetched_and_recorded_and_found(server, says, cache):
    told = []
    done = install.install_from_network(
        "stable-4.5.3", server.url, lambda *progress: told.append(progress)
    )
    assert done.path.read_bytes() == PROGRAM
    assert done.path.stat().st_mode & 0o111
    assert told[0] == (0, len(PROGRAM))
    assert told[-1] == (len(PROGRAM), len(PROGRAM))
    assert binary.find_binary() == done
    assert done.version == "4.5.3"
    assert done.sha256 == hashlib.sha256(PROGRAM).hexdigest()
    record = (cache / binary.RECORD_NAME).read_text()
    assert f"size_bytes = {len(PROGRAM)}\n" in record
    assert f'sha256 = "{done.sha256}"\n' in record
    # Nothing else is left there.
    assert {path.name for path in cache.iterdir()} == {binary.PROGRAM_NAME, binary.RECORD_NAME}


def test_a_broken_transfer_goes_on_by_itself(server, says):
    server.breaks_after = [1000, 500]
    assert fetched(server).path.read_bytes() == PROGRAM
    assert server.ranges == [None, "bytes=1000-", "bytes=1500-"]


def test_a_broken_transfer_goes_on_next_time(server, says, cache):
    server.breaks_after = [1000, 1, 1]
    told = complaint(fetched, server, error=RunError)
    assert "1002 of" in told
    assert "Run the same command again" in told
    assert "--from FILE" in told
    assert not (cache / binary.PROGRAM_NAME).exists()
    assert fetched(server).path.read_bytes() == PROGRAM
    assert server.ranges[-1] == "bytes=1002-"


def test_what_was_broken_off_is_dropped_where_the_file_is_another_now(server, says):
    server.breaks_after = [1000, 1, 1]
    complaint(fetched, server, error=RunError)
    server.etag, server.content = '"two"', PROGRAM + b"new"
    assert fetched(server).path.read_bytes() == PROGRAM + b"new"


def test_a_server_without_versions_is_asked_for_all_of_it(server, says):
    server.etag, server.breaks_after = 'W/"one"', [1000]
    assert fetched(server).path.read_bytes() == PROGRAM
    assert server.ranges == [None, None]


def test_what_is_longer_than_the_file_is_dropped(server, says, cache):
    server.breaks_after = [1000, 1, 1]
    complaint(fetched, server, error=RunError)
    (cache / "ardusub.part").write_bytes(bytes(len(PROGRAM) + 5))
    assert fetched(server).path.read_bytes() == PROGRAM


def test_no_such_file(server, cache):
    url = f"{server.base}/else"
    told = complaint(install.install_from_network, "latest", url, nothing)
    assert url in told
    assert "404" in told


def test_no_network():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/ardusub"
    told = complaint(install.install_from_network, "latest", url, nothing, error=RunError)
    assert url in told
    assert "refused" in told
    assert "without network" in told
    assert "--from FILE" in told


@pytest.mark.parametrize("url", ["ftp://example.org/ardusub", "file:///bin/true", "ardusub"])
def test_other_addresses_are_refused(url):
    assert "http" in complaint(install.install_from_network, "latest", url, nothing)


def test_addresses_of_official_builds():
    assert "/Sub/stable-4.5.3/" in install.official_url("stable-4.5.3")
    assert "--version" in complaint(install.official_url, "../../Copter")


def test_a_page_instead_of_a_program_is_refused(server, says, cache):
    server.content = b"<html>Please log in</html>"
    assert "web page" in complaint(fetched, server)
    assert not list(cache.glob("ardusub*"))


def with_machine(number):
    return PROGRAM[:18] + struct.pack("<H", number) + PROGRAM[20:]


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (PROGRAM[:40], "not a complete"),
        (with_machine(22), "ELF machine 22"),
        (PROGRAM[:16] + struct.pack("<H", 1) + PROGRAM[18:], "not a program"),
        (PROGRAM.replace(b"/ld-linux", b"/ld-musl!"), "dynamic loader"),
    ],
)
def test_programs_of_other_machines_are_refused(tmp_path, content, words):
    path = tmp_path / "ardusub"
    path.write_bytes(content)
    told = complaint(install.install_from_file, path)
    assert words in told
    assert str(path) in told


def test_a_program_that_is_no_ardusub_is_refused(server, cache):
    told = complaint(fetched, server)
    assert "does not act as an ArduSub" in told
    assert "exit code 0" in told
    assert not (cache / binary.PROGRAM_NAME).exists()


def test_a_wrong_checksum_is_refused(server, says, cache):
    told = complaint(fetched, server, checksum="00" * 32)
    assert hashlib.sha256(PROGRAM).hexdigest() in told
    assert not (cache / binary.PROGRAM_NAME).exists()


def official(server, monkeypatch, version):
    monkeypatch.setattr(install, "official_url", lambda _: server.url)
    return install.install_from_network(version, None, nothing)


def test_a_release_that_changed_is_refused_and_the_old_one_stays(server, says, monkeypatch):
    before = official(server, monkeypatch, "stable-4.5.3")
    server.etag, server.content = '"two"', PROGRAM + b"changed"
    told = complaint(official, server, monkeypatch, "stable-4.5.3")
    assert before.sha256 in told
    assert binary.find_binary() == before
    says[0] = "4.7.0-dev"
    assert official(server, monkeypatch, "latest").version == "4.7.0-dev"


def test_a_release_that_says_another_version_is_refused(server, says, monkeypatch):
    says[0] = "4.1.0"
    assert "says it is 4.1.0" in complaint(official, server, monkeypatch, "stable-4.5.3")


def test_a_program_that_was_changed_after_it_was_installed_is_refused(server, says):
    done = fetched(server)
    done.path.write_bytes(PROGRAM + b"changed")
    told = complaint(binary.find_binary)
    assert done.sha256 in told
    assert "angler sitl install" in told


def test_from_a_file_with_the_record_of_another_machine(server, says, cache, tmp_path):
    fetched(server)
    stick = tmp_path / "stick"
    shutil.copytree(cache, stick)
    assert (
        install.install_from_file(stick / binary.PROGRAM_NAME).path == cache / binary.PROGRAM_NAME
    )
    (stick / binary.PROGRAM_NAME).write_bytes(PROGRAM + b"changed")
    assert "should be" in complaint(install.install_from_file, stick / binary.PROGRAM_NAME)


def test_which_one_is_run(server, says, tmp_path, monkeypatch):
    assert "angler sitl install" in complaint(binary.find_binary)
    installed = fetched(server)
    mine, other = tmp_path / "mine", tmp_path / "other"
    for path in (mine, other):
        shutil.copyfile(installed.path, path)
        path.chmod(0o755)
    assert binary.find_binary() == installed
    monkeypatch.setenv(binary.ENVIRONMENT_VARIABLE, str(mine))
    assert binary.find_binary().path == mine
    assert binary.find_binary(other).path == other


def test_a_named_program_must_be_there_and_may_be_run(tmp_path, monkeypatch):
    monkeypatch.setenv(binary.ENVIRONMENT_VARIABLE, str(tmp_path / "none"))
    assert complaint(binary.find_binary).startswith("ANGLER_ARDUSUB: ")
    path = tmp_path / "ardusub"
    path.write_bytes(PROGRAM)
    told = complaint(binary.find_binary, path)
    assert told.startswith("--ardusub: ")
    assert f"chmod +x {path}" in told


def test_the_command_says_one_message_and_exits_with_2(server, capsys):
    for given in (["--url", f"{server.base}/else"], ["--url", server.url, "--from", "/bin/true"]):
        with pytest.raises(SystemExit) as left:
            main(["sitl", "install", *given])
        assert left.value.code == 2
        assert capsys.readouterr().err.count("angler: ") == 1


@pytest.mark.sitl
def test_the_real_one_is_installed_from_a_server_that_breaks_off(
    ardusub, server, cache, capsys, tmp_path
):
    server.content = ardusub.path.read_bytes()
    server.breaks_after = [len(server.content) // 2]
    main(["sitl", "install", "--url", server.url])
    assert Path(capsys.readouterr().out.strip()) == cache / binary.PROGRAM_NAME
    found = binary.find_binary()
    assert found.sha256 == ardusub.sha256
    # As the program says itself: three numbers, and what kind of build it is.
    assert found.version.split("-")[0].count(".") == 2
