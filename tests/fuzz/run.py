"""Many wrong inputs for every reader: ``python -m tests.fuzz.run --count 1000000 --seed 1``.

Inputs are named by reader, seed and number, so that one can be made again. What raises another's
error, takes more than a second of processor time or 200 MB is written to ``--out`` with its
traceback, and the exit code is 1.
"""

import argparse
import gc
import os
import random
import resource
import sys
import tempfile
import time
import traceback
import warnings
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from .mutations import wrong

MOST_S, MOST_BYTES = 1.0, 200 * 2**20
CHUNK = 2000


def input_of(reader, seed, number):
    """The input of that number."""
    rng = random.Random(f"{seed}/{reader.name}/{number}")
    return wrong(rng, rng.choice(reader.inputs), reader.inputs, reader.end)


def _peak_bytes():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024


def _chunk(name, seed, first, count, out):
    """Inputs ``first`` and after: how many failed, the slowest, and the most memory of one."""
    from .readers import READERS, try_one

    warnings.simplefilter("ignore")
    reader, failed, slowest, largest = READERS[name], 0, (0.0, -1), (0, -1)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"input{reader.end}"
        try_one(reader, reader.inputs[0], path)
        for number in range(first, first + count):
            data = input_of(reader, seed, number)
            before, begun, fault = _peak_bytes(), time.process_time(), ""
            try:
                try_one(reader, data, path)
            except Exception:  # whatever it is, it is what is looked for
                fault = traceback.format_exc()
            took, grown = time.process_time() - begun, _peak_bytes() - before
            slowest, largest = max(slowest, (took, number)), max(largest, (grown, number))
            if took > MOST_S:
                fault += f"\n{took:.2f} s"
            if grown > MOST_BYTES:
                fault += f"\n{grown / 2**20:.0f} MB more"
            if fault:
                failed += 1
                place = Path(out) / f"{name}-{seed}-{number}"
                place.with_suffix(".input").write_bytes(data)
                place.with_suffix(".txt").write_text(fault, encoding="utf-8")
    gc.collect()
    return name, failed, slowest, largest


def main():
    """Feed all readers, and say what came of it."""
    from .readers import READERS

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--count", type=int, default=100_000, help="inputs of all readers together")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--reader", choices=sorted(READERS), action="append")
    parser.add_argument("--out", type=Path, default=Path("runs/fuzz"))
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    names = given.reader or list(READERS)
    each = -(-given.count // len(names))
    jobs = [
        (name, given.seed, first, min(CHUNK, each - first), str(given.out))
        for first in range(0, each, CHUNK)
        for name in names
    ]
    totals = {name: [0, 0, (0.0, -1), (0, -1)] for name in names}
    # Forked, workers would share the threads of what is imported by now.
    with ProcessPoolExecutor(given.workers, get_context("spawn")) as pool:
        for job, found in zip(jobs, pool.map(_chunk, *zip(*jobs, strict=True)), strict=True):
            name, failed, slowest, largest = found
            total = totals[name]
            total[0] += job[3]
            total[1] += failed
            total[2], total[3] = max(total[2], slowest), max(total[3], largest)
    print("reader        inputs  failed  slowest (number)      most memory (number)")
    for name, (count, failed, slowest, largest) in totals.items():
        print(
            f"{name:12} {count:7}  {failed:6}  {slowest[0]:6.3f} s ({slowest[1]})"
            f"{'':6}{largest[0] / 2**20:6.1f} MB ({largest[1]})"
        )
    bad = sum(total[1] for total in totals.values())
    if bad:
        print(f"{bad} inputs failed; they lie in {given.out}")
    sys.exit(bool(bad))


if __name__ == "__main__":
    main()
