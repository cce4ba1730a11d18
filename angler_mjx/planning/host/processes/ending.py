"""The end of a process whose parent is gone, whatever it is doing."""

import fcntl
import os
import select
import sys


def end_with(watch: int) -> None:
    """Has the kernel end this process's group when the other end of a pipe is closed.

    A thread that watched the pipe would wait for the interpreter, which a planner may hold for
    ever; the signal that the kernel sends then (SIGIO, whose default is the end) waits for nobody.

    Args:
        watch: descriptor of a pipe's reading end, to which nothing is ever written.
    """
    fcntl.fcntl(watch, fcntl.F_SETOWN, -os.getpgrp())
    fcntl.fcntl(watch, fcntl.F_SETFL, fcntl.fcntl(watch, fcntl.F_GETFL) | os.O_ASYNC)
    if select.select([watch], [], [], 0.0)[0]:
        sys.exit(1)
