"""One search of phase 1 as a process of its own: python search_process.py hitchid|mealpy TESTS.npz."""

import sys
from pathlib import Path

WHALES, ITERATIONS, SEED = 30, 100, 0


def by_mealpy(path: Path) -> float:
    """Return the best J that mealpy finds."""
    from lfilter_whale import Lifting, search

    return search(Lifting.load(path), SEED, WHALES, ITERATIONS)


def by_hitchid(path: Path) -> float:
    """Return the best J that hitchid finds, its compiled programs in the user's cache."""
    from hitchid._support.jax_setup import prepare_jax

    prepare_jax()
    import jax

    jax.config.update("jax_enable_x64", True)
    from lifting import load_batch, search

    return search(load_batch(path), SEED, WHALES, ITERATIONS)


if __name__ == "__main__":
    best = {"hitchid": by_hitchid, "mealpy": by_mealpy}[sys.argv[1]](Path(sys.argv[2]))
    sys.stdout.write(f"{best!r}\n")
