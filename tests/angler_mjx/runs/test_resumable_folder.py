"""The frame of a folder that is made part by part: begun, met, interrupted, resumed, published."""

import json

import pytest

from angler_mjx.errors import ConfigError, RunError
from angler_mjx.runs.processes import OneProcess
from angler_mjx.runs.resumable_folder import ResumableFolder, open_folder
from angler_mjx.runs.storage import output_lock

from ..threads import together

REQUEST, RESULT = "request.json", "result"


def declare(request="a"):
    def begin(building):
        (building / REQUEST).write_text(json.dumps(request))
        return request

    def resume(building):
        stored = json.loads((building / REQUEST).read_text())
        if stored != request:
            raise ConfigError(f"begun with {stored}")
        return stored

    return ResumableFolder(
        kind="study",
        request_file=REQUEST,
        begin=begin,
        resume=resume,
        is_complete=lambda out: (out / RESULT).is_file(),
    )


def fill(out, *, resume=False, request="a", processes=None, error=None):
    held = open_folder(declare(request), out, resume=resume, processes=processes or OneProcess())
    with held as opened:
        if error is not None:
            raise error
        opened.publish(lambda building: (building / RESULT).write_text(opened.start))
    return opened.start


def test_a_folder_is_published_whole(tmp_path):
    out = tmp_path / "out"
    assert fill(out) == "a"
    assert sorted(path.name for path in out.iterdir()) == [REQUEST, RESULT]
    assert not output_lock.partial_path(out).exists()
    with pytest.raises(ConfigError, match="this study is complete"):
        fill(out, resume=True)
    with pytest.raises(ConfigError, match="exists; give another folder"):
        fill(out)


@pytest.mark.parametrize("error", [KeyboardInterrupt, RunError("no memory")])
def test_an_interrupted_folder_is_resumed_by_the_same_request_alone(tmp_path, error):
    out = tmp_path / "out"
    with pytest.raises((KeyboardInterrupt, RunError)):
        fill(out, error=error)
    assert not out.exists()
    with pytest.raises(ConfigError, match="go on with it with --resume"):
        fill(out)
    with pytest.raises(ConfigError, match="begun with a"):
        fill(out, resume=True, request="b")
    assert fill(out, resume=True) == "a"
    assert (out / RESULT).read_text() == "a"


def test_a_full_disk_keeps_the_parts_and_says_how_to_go_on(tmp_path):
    out = tmp_path / "out"

    def write(building):
        raise OSError(28, "No space left on device")

    with (
        pytest.raises(RunError, match=r"No space left.*make room and go on with --resume"),
        open_folder(declare(), out, resume=False, processes=OneProcess()) as opened,
    ):
        opened.publish(write)
    assert fill(out, resume=True) == "a"


def test_of_several_processes_one_writes_and_all_know_the_start(tmp_path):
    out = tmp_path / "out"
    ends, processes = together(3, lambda one: fill(out, processes=one))
    assert ends == ["a"] * 3
    assert [one.left for one in processes] == [0, 0, 0]
    assert (out / RESULT).read_text() == "a"


def test_a_refusal_ends_all_processes(tmp_path):
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "other").touch()
    ends, processes = together(2, lambda one: fill(tmp_path / "out", processes=one))
    assert [type(end) for end in ends] == [ConfigError, RunError]
    assert [one.left for one in processes] == [1, 1]
