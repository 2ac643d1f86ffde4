"""How programs are compiled, and that the cache of compiled ones does not grow without end."""

import os
import subprocess
import sys

import pytest

from hitchid._support import jax_setup


def test_of_too_many_programs_the_newer_half_stays(tmp_path, monkeypatch):
    monkeypatch.setattr(jax_setup, "MAX_PROGRAMS", 4)
    for age in range(5):
        (tmp_path / f"{age}-cache").touch()
        os.utime(tmp_path / f"{age}-cache", (1000 - age, 1000 - age))

    jax_setup._evict_oldest(tmp_path)
    jax_setup._evict_oldest(tmp_path / "none")  # is no error

    assert sorted(path.name for path in tmp_path.iterdir()) == ["0-cache", "1-cache"]


@pytest.mark.parametrize(
    ("set_by_user", "jaxlib", "expected"),
    [
        (None, "0.10.2", jax_setup.CODE_GENERATOR),
        ("--xla_dump_to=x", "0.10.2", "--xla_dump_to=x"),
        # XLA would end the process at a flag that it no longer knows.
        (None, "0.100.0", None),
    ],
)
def test_the_code_generator_is_chosen_where_that_was_tried(monkeypatch, set_by_user, jaxlib, expected):
    environment = {} if set_by_user is None else {"XLA_FLAGS": set_by_user}
    monkeypatch.setattr(jax_setup.os, "environ", environment)
    monkeypatch.setattr(jax_setup, "version", lambda _: jaxlib)

    jax_setup.choose_code_generator()

    assert environment.get("XLA_FLAGS") == expected


def test_the_installed_jaxlib_knows_the_flag_survives_a_cut_cache(tmp_path):
    unset = ("XLA_FLAGS", "JAX_COMPILATION_CACHE_DIR")
    environment = {name: value for name, value in os.environ.items() if name not in unset}
    environment["XDG_CACHE_HOME"] = str(tmp_path)
    program = (
        "from hitchid._support.jax_setup import prepare_jax; prepare_jax(); import os, jax; "
        "print(jax.jit(lambda x: x + 1)(1.0), os.environ['XLA_FLAGS'])"
    )

    for _ in range(2):
        run = subprocess.run(  # noqa: S603
            [sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True
        )
        assert (run.stdout.split(), run.stderr) == (["2.0", jax_setup.CODE_GENERATOR], "")
        (entry,) = (tmp_path / "hitchid" / "compiled").glob("*-cache")
        os.truncate(entry, entry.stat().st_size // 2)
