"""Generated code under bad input: numbers that are not finite, damaged saved states, two at a time."""

import ctypes
import math
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location

import numpy as np
import pytest

SANITIZERS = ("-g", "-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all")
FUZZ = r"""
#include "hitch.h"
#include <math.h>
#include <stdio.h>
static uint64_t seed = 88172645463325252u;
static uint64_t next(void) { seed ^= seed << 13; seed ^= seed >> 7; seed ^= seed << 17; return seed; }
static hitch_real odd(void)
{
    static const hitch_real values[] = {
        0, -0.0, 1, -1, 0.5, 1e-310, 1e9, -1e9, 1e8, 1e308, -1e308, INFINITY, -INFINITY, NAN, 100, 350
    };
    const uint64_t kind = next();
    return kind % 3 ? (hitch_real)((double)(next() % 2000000) / 1e6 - 0.5) : values[next() % 16];
}
int main(void)
{
    hitch_state state;
    hitch_input input;
    hitch_output output;
    uint8_t bytes[HITCH_SAVED_BYTES];
    long i;
    hitch_real load[4] = { 100, NAN, INFINITY, 0 };
    hitch_init(&state, odd(), load);
    (void)load;
    for (i = 0; i < 1000000; i++) {
        input.lifting_command = odd();
        input.lowering_command = odd();
        input.displacement_measured = next() % 2 ? 100 + odd() : odd();
        input.measurement_valid = (int32_t)(next() % 3);
        hitch_step(&state, &input, &output);
        if (!isfinite(output.displacement)) { printf("not finite at %ld\n", i); return 1; }
        if (i % 1000 == 0) {
            hitch_save(&state, bytes);
            if (hitch_load(&state, bytes, sizeof bytes) != 0) return 2;
        }
        if (next() % 50000 == 0) hitch_init(&state, odd(), load);
    }
    return 0;
}
"""


@pytest.fixture(scope="session")
def library(exported, compiler):
    """Return the Python module beside the compiled code."""
    compiler.compile([exported / "hitch.c"], exported / "libhitch.so", "-fPIC", "-shared")
    spec = spec_from_file_location("exported_hitch", exported / "hitch.py")
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_every_output_is_finite_and_memory_is_not_harmed(exported, compiler, tmp_path) -> None:
    source = tmp_path / "fuzz.c"
    source.write_text(FUZZ)
    compiler.compile([source, exported / "hitch.c"], tmp_path / "fuzz", f"-I{exported}", *SANITIZERS)
    done = subprocess.run([tmp_path / "fuzz"], capture_output=True, text=True, check=False)  # noqa: S603
    assert done.returncode == 0, done.stdout + done.stderr[:2000]


def test_the_self_test_passes_and_sees_an_error(exported, compiler, tmp_path) -> None:
    sources = [exported / "hitch.c", exported / "hitch_selftest.c"]
    compiler.compile(sources, tmp_path / "selftest", "-DHITCH_SELFTEST_MAIN")
    assert subprocess.run([tmp_path / "selftest"], check=False).returncode == 0  # noqa: S603
    damaged = tmp_path / "hitch.c"
    text = (exported / "hitch.c").read_text()
    damaged.write_text(text.replace("state->error = error;", "state->error = error + 0.1f;"))
    assert damaged.read_text() != text
    compiler.compile([damaged, sources[1]], tmp_path / "failing", f"-I{exported}", "-DHITCH_SELFTEST_MAIN")
    assert subprocess.run([tmp_path / "failing"], check=False).returncode == 1  # noqa: S603


def test_fast_math_is_refused(exported, compiler, tmp_path) -> None:
    command = [*compiler.command, "-ffast-math", "-c", "hitch.c", "-o", str(tmp_path / "hitch.o")]
    done = subprocess.run(command, cwd=exported, capture_output=True, text=True, check=False)  # noqa: S603
    assert done.returncode != 0
    assert "-ffast-math" in done.stderr


def test_the_library_repeats_the_model(everything, library) -> None:
    model = library.Model(100.0)
    state = everything.init_state(100.0)
    rng = np.random.default_rng(3)
    for number in range(300):
        commands = rng.uniform(0, 0.8, 2) if number % 40 > 10 else np.zeros(2)
        measured = math.nan if number < 100 else float(100 + 0.01 * number)
        state, expected = everything.step(state, commands, measured)
        assert model.step(*commands, measured) == pytest.approx(float(expected), abs=1e-6)
    assert model.mode == int(everything.unpack_state(state).mode)
    assert model.half_width > 0


def test_a_saved_state_goes_on_in_another_process(exported, library) -> None:
    model = library.Model(100.0)
    for number in range(150):
        model.step(0.7, 0.0, 100.0 + 0.1 * number)
    saved = model.save()
    program = (
        "import sys; sys.path.insert(0, sys.argv[1]); import hitch\n"
        "model = hitch.Model(0.0); model.load(bytes.fromhex(sys.argv[2]))\n"
        "print(repr([model.step(0.0, 0.6, 90.0) for _ in range(5)]))"
    )
    arguments = [sys.executable, "-S", "-c", program, str(exported), saved.hex()]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True)  # noqa: S603
    assert done.stdout.strip() == repr([model.step(0.0, 0.6, 90.0) for _ in range(5)])


def test_bytes_that_are_no_state_are_refused_and_change_nothing(library) -> None:
    model = library.Model(100.0)
    model.step(0.7, 0.0, 100.0)
    saved = model.save()
    rng = np.random.default_rng(1)
    damaged = [b"", saved[:-1], saved + b"\0", bytes(len(saved)), b"HITC" + bytes(len(saved) - 4)]
    for _ in range(1000):
        at, bit = int(rng.integers(len(saved))), int(rng.integers(8))
        flipped = bytearray(saved)
        flipped[at] ^= 1 << bit
        damaged.append(bytes(flipped))
    for content in damaged:
        with pytest.raises(ValueError, match="not a state"):
            model.load(content)
    assert model.save() == saved


def test_a_state_may_be_copied_byte_by_byte(library) -> None:
    model, twin = library.Model(100.0), library.Model(0.0)
    model.step(0.7, 0.0, 100.0)
    ctypes.memmove(twin._state, model._state, ctypes.sizeof(model._state))
    assert [twin.step(0.7, 0.0) for _ in range(20)] == [model.step(0.7, 0.0) for _ in range(20)]
