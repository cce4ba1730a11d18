"""The hash of JAX's random numbers, written out: known answers, and the same numbers as before."""

import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from angler_kernels.threefry import hashed

KNOWN = [
    ((0x00000000, 0x00000000), (0x00000000, 0x00000000), (0x6B200159, 0x99BA4EFE)),
    ((0xFFFFFFFF, 0xFFFFFFFF), (0xFFFFFFFF, 0xFFFFFFFF), (0x1CB996FC, 0xBB002BE7)),
    ((0x13198A2E, 0x03707344), (0x243F6A88, 0x85A308D3), (0xC4923A9C, 0x483DF7A0)),
]
"""Key, counter and hash of threefry2x32 with 20 rounds, from Random123's own kat_vectors."""

DRAWN = """
import sys
import jax
import numpy as np

if sys.argv[1] == "out":
    from angler_kernels.threefry import write_out_on_cpu

    write_out_on_cpu()
keys = jax.random.split(jax.random.fold_in(jax.random.key(7), 3), 5)
some = jax.vmap(lambda key: jax.random.normal(key, (3, 4)))(keys)
program = jax.jit(lambda key: jax.random.uniform(key, (8,))).lower(keys[0]).as_text()
print(np.asarray(some).tobytes().hex(), "while" in program)
"""


@pytest.mark.parametrize(("key", "counter", "expected"), KNOWN)
def test_known_answers(key, counter, expected):
    words = [np.uint32(word) for word in (*key, *counter)]
    found = jax.jit(hashed)(*words)
    assert tuple(int(word) for word in found) == expected


def test_keys_and_words_of_any_shape_go_together():
    key = jnp.array([[1], [2]], jnp.uint32)
    words = jnp.arange(3, dtype=jnp.uint32)
    many = np.stack(hashed(key, key + 1, words, words * 0))
    for row in range(2):
        for column in range(3):
            one = hashed(key[row, 0], key[row, 0] + 1, words[column], jnp.uint32(0))
            assert [int(word) for word in one] == many[:, row, column].tolist()


def test_what_is_drawn_stays_the_same_and_the_loop_is_gone():
    """Each in a process of its own, because the rule is for a whole process."""

    def drawn(how):
        command = [sys.executable, "-c", DRAWN, how]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        numbers, loop = done.stdout.split()
        return numbers, loop

    as_jax, with_loop = drawn("jax")
    out, without = drawn("out")
    assert out == as_jax
    assert (with_loop, without) == ("True", "False")
