"""Tests compile quickly, and as users' programs are compiled where that is asked for."""

from __future__ import annotations

import os

import jax
import jax.numpy as jnp
from jax._src import compiler

from tests.compiling import FLAGS, QUICK, as_users_have_it, flags_of_users


def overridden() -> dict[str, str]:
    return dict(compiler.get_compile_options(1, 1).env_option_overrides)


def test_what_is_compiled_for_users_takes_back_each_flag_of_ours_here_and_in_programs_that_are_started() -> None:
    quick, before = os.environ.get(FLAGS, ""), overridden()
    ours = {f"--{name}={value}" for name, (value, _) in QUICK.items()}
    assert ours <= set(quick.split()) or not ours & set(quick.split()), "all of them, or none with another compiler"
    step = jax.jit(lambda x: jnp.sin(x) @ x.T)
    known = step(jnp.ones((8, 8)))
    with as_users_have_it():
        assert overridden() == {name: usual for name, (_, usual) in QUICK.items()}
        assert not ours & set(os.environ[FLAGS].split())
        assert jnp.allclose(step(jnp.ones((8, 8))), known), "the compiler takes them"
    assert os.environ.get(FLAGS, "") == quick and overridden() == before


def test_flags_of_others_stay() -> None:
    given = "--xla_cpu_max_isa=SSE4_2 --xla_cpu_prefer_vector_width=128 --xla_force_host_platform_device_count=2"
    assert flags_of_users({FLAGS: given}) == "--xla_cpu_max_isa=SSE4_2 --xla_force_host_platform_device_count=2"
    assert flags_of_users({}) == ""
