"""User cache of compiled programs."""

import os
from pathlib import Path

MAX_PROGRAMS = 10_000  # compiled programs kept, about 100 MB (chosen)


def prepare_jax() -> None:
    """Enable JAX's compilation cache in the user's cache folder, unless another folder is set."""
    import jax

    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        compiled_folder = cache_folder() / "compiled"
        _evict_oldest(compiled_folder)
        jax.config.update("jax_compilation_cache_dir", str(compiled_folder))
        # Small programs too: hundreds of them take longer to compile than the large ones.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def _evict_oldest(programs: Path) -> None:
    """Keep only the newest half of `MAX_PROGRAMS` programs if there are more than that."""
    try:
        entries = list(os.scandir(programs)) if programs.is_dir() else []
        if len(entries) > MAX_PROGRAMS:
            entries.sort(key=lambda entry: entry.stat().st_mtime)
            for entry in entries[: -MAX_PROGRAMS // 2]:
                Path(entry).unlink(missing_ok=True)
    except OSError:
        return  # another process evicts, or removal is not permitted


def cache_folder() -> Path:
    """Return the user's cache folder of this package."""
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hitchid"
