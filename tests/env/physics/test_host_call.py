"""Python functions as XLA custom calls."""

import os
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from bp2_rl.env.physics import host_call


def call(name, *arguments):
    shape = jax.ShapeDtypeStruct(arguments[0].shape, jnp.float32)
    return jax.ffi.ffi_call(name, [shape], vmap_method="broadcast_all")(*arguments)[0]


def test_the_function_reads_and_writes_the_arrays_of_xla_batch_axes_and_scalars_included():
    def scale(results, arguments):
        x, factor = arguments
        assert (x.shape, factor.shape) == ((3, 2, 4), (3, 2))
        results[0][...] = x * factor[..., None]

    host_call.register("test_scale", scale)
    x, factor = jnp.arange(24.0).reshape(3, 2, 4), jnp.arange(6.0).reshape(3, 2)
    scaled = jax.jit(jax.vmap(jax.vmap(lambda x, factor: call("test_scale", x, factor))))(x, factor)
    np.testing.assert_array_equal(scaled, np.asarray(x) * np.asarray(factor)[..., None])


def test_what_goes_wrong_in_the_function_is_said():
    def fail(results, arguments):
        raise ValueError(f"no robot weighs {arguments[0][0]} kg")

    host_call.register("test_fail", fail)
    with pytest.raises(jax.errors.JaxRuntimeError, match=r"ValueError: no robot weighs -1\.0 kg"):
        jax.block_until_ready(call("test_fail", jnp.full(2, -1.0)))


def test_a_compiled_program_is_found_on_disk_and_calls_the_function_of_its_own_process(tmp_path):
    program = """
import sys, jax, jax.numpy as jnp
from bp2_rl.env.physics import host_call
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
found = []
jax.monitoring.register_event_listener(lambda event, **_: found.append(event))
def add(results, arguments):
    results[0][...] = arguments[0] + float(sys.argv[1])
host_call.register("test_add", add)
x = jnp.ones(3)
run = jax.jit(lambda x: 2 * jax.ffi.ffi_call("test_add", [jax.ShapeDtypeStruct(x.shape, x.dtype)])(x)[0])
print(run(x), "/jax/compilation_cache/cache_hits" in found)
"""
    env = os.environ | {"JAX_PLATFORMS": "cpu", "JAX_COMPILATION_CACHE_DIR": str(tmp_path)}
    said = [
        subprocess.run([sys.executable, "-c", program, number], env=env, check=True, capture_output=True, text=True)
        for number in ("1", "10")
    ]
    assert [run.stdout.splitlines()[-1] for run in said] == ["[4. 4. 4.] False", "[22. 22. 22.] True"]
