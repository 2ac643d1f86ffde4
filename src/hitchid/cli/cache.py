"""What is kept in the user's cache: compiled programs, and finished searches."""

import os
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hitchid.fitting import Comparison


def prepare_jax() -> None:
    """Keep compiled programs in the user's cache, unless JAX knows a place: the next run starts faster."""
    import jax

    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        jax.config.update("jax_compilation_cache_dir", str(_cache() / "compiled"))
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.3)


def resumable(comparison: "Comparison | None") -> "Comparison | None":
    """Keep finished searches in the user's cache, so that a run that was stopped goes on from there."""
    from hitchid.checkpoints import Checkpoints

    return comparison and replace(comparison, kept=Checkpoints(_cache() / "searches"))


def _cache() -> Path:
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hitchid"
