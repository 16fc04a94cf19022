"""Training compiles in its first iterations and never again: a compilation later would
stall every device."""

import jax
from aim import TINY, Aim
from jax.experimental.compilation_cache import compilation_cache

from bp2_rl.learning.ppo import PPO
from bp2_rl.tools.throughput import COMPILED, FROM_CACHE, compilations


def test_nothing_is_compiled_after_the_first_two_iterations():
    learner = PPO(Aim(), TINY)
    with compilations() as first:
        state = learner.init(0)
        for _ in range(2):
            state, metrics = learner.train_step(state)
    assert first[COMPILED] >= 2  # init and the train step: the listener hears
    with compilations() as later:
        for _ in range(3):
            state, metrics = learner.train_step(state)
    jax.block_until_ready(metrics)
    assert later[COMPILED] == 0
    assert int(state.step) == 5


def test_programs_are_counted_once_each_and_only_within():
    @jax.jit
    def double(x):
        return 2 * x

    with compilations() as outer:
        double(1.0)
        with compilations() as inner:
            double(2.0)
        double(1)  # another type is another program
    double(True)
    assert (outer[COMPILED], inner[COMPILED]) == (2, 0)


def test_what_the_cache_on_disk_holds_is_told_apart(tmp_path):
    def make():
        return jax.jit(lambda x: x**3 - 7.0)

    old = {name: getattr(jax.config, name) for name in SETTINGS}
    try:
        for name, value in SETTINGS.items():
            jax.config.update(name, str(tmp_path) if value is None else value)
        compilation_cache.reset_cache()
        with compilations() as cold:
            make()(2.0)
        with compilations() as warm:
            make()(2.0)
    finally:
        for name, value in old.items():
            jax.config.update(name, value)
        compilation_cache.reset_cache()
    assert (cold[COMPILED], cold[FROM_CACHE]) == (1, 0)
    assert (warm[COMPILED], warm[FROM_CACHE]) == (1, 1)


SETTINGS = {
    "jax_compilation_cache_dir": None,
    "jax_persistent_cache_min_compile_time_secs": 0.0,
    "jax_persistent_cache_min_entry_size_bytes": 0,
}
