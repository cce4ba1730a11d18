"""Threads that stand for the processes of a shared run (`angler_mjx.runs.processes.Processes`)."""

import json
import threading

from angler_mjx.errors import RunError


class Board:
    """What the threads of a test leave for each other; a name is met for once."""

    def __init__(self, count):
        self.count, self.said, self.failed = count, {}, []
        self.changed = threading.Condition()


class OneThread:
    """One of several threads that stand for processes."""

    stopping = False

    def __init__(self, board, index):
        self.board, self.index, self.count, self.left = board, index, board.count, 0
        self.stops = 0

    def check(self):
        if self.board.failed:
            raise RunError(self.board.failed[0])

    def meet(self, name, value=None):
        with self.board.changed:
            there = self.board.said.setdefault(name, {})
            assert self.index not in there, f"met for {name} twice"
            there[self.index] = json.dumps(value)
            self.board.changed.notify_all()
            while len(there) < self.count:
                self.check()
                assert self.board.changed.wait(timeout=60)
            return [json.loads(there[i]) for i in range(self.count)]

    def stop(self):
        self.stops += 1

    def fail(self, reason):
        with self.board.changed:
            self.board.failed.append(reason)
            self.board.changed.notify_all()

    def leave(self):
        self.left += 1


def together(count, act):
    """What each of so many threads gave or raised."""
    board = Board(count)
    ours = [OneThread(board, i) for i in range(count)]
    ends = [None] * count

    def run(i):
        try:
            ends[i] = act(ours[i])
        except Exception as error:
            ends[i] = error

    threads = [threading.Thread(target=run, args=(i,)) for i in range(count)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(timeout=120)
    return ends, ours
