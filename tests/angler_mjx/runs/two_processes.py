"""One of two processes that share work; one of them may go away.

Arguments: port of the coordinator, index, and what process 1 does after the first meeting: "die"
without a word, "fail" with one, or go on to "meet" again.
"""

import os
import sys

import jax

from angler_mjx.errors import RunError
from angler_mjx.runs import processes


def main(port, index, then):
    jax.config.update("jax_platforms", "cpu")
    # Two seconds without a sign of life count as death here, so that the test is short.
    joined = processes.join_processes(f"localhost:{port}", 2, index, gone_s=2.0)
    print(joined.meet("one", {"process": index}))
    if index == 1 and then == "die":
        os._exit(3)
    if index == 1 and then == "fail":
        joined.fail("its disk is full")
        joined.leave()
        sys.exit(4)
    try:
        print(joined.meet("two"))
    except RunError as error:
        joined.leave()
        sys.exit(f"angler: {error}")
    joined.leave()


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), sys.argv[3])
