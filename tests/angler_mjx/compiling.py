"""How tests of equations compile their own programs."""

from functools import partial

import jax

quickly = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 0})
"""`jax.jit` without optimisation: of such a test's time most is spent in compiling, and the
equations are the same."""

thoroughly = partial(jax.jit, compiler_options={"xla_backend_optimization_level": 1})
"""`jax.jit` with a little optimisation, where most of a test's time is spent in running."""
