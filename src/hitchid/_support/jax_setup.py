"""How programs of JAX are compiled, and the user's cache of compiled ones."""

import os
import warnings
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

# Versions of the packages that results depend on.

PACKAGES = ("hitchid", "jax", "jaxlib", "equinox", "optax", "numpy", "scipy")


def installed_versions() -> dict[str, str]:
    """Return package to version of the packages that results depend on."""

    def installed(package: str) -> str:
        try:
            return version(package)
        except PackageNotFoundError:
            return "unknown"

    return {package: installed(package) for package in PACKAGES}


MAX_PROGRAMS = 10_000  # compiled programs kept, about 100 MB (chosen)
# XLA's newer code generator takes twice as long to compile, and its programs are no faster. As XLA ends the
# process at a flag that it does not know, only versions of jaxlib with which this was tried are given it.
CODE_GENERATOR = "--xla_cpu_use_fusion_emitters=false"
TRIED_VERSIONS = ("0.9.", "0.10.")


def prepare_jax() -> None:
    """Choose XLA's code generator and enable JAX's compilation cache, before anything is computed.

    What the user has set, in `XLA_FLAGS` or `JAX_COMPILATION_CACHE_DIR`, stays.
    """
    choose_code_generator()
    import jax

    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        compiled_folder = cache_folder() / "compiled"
        _evict_oldest(compiled_folder)
        jax.config.update("jax_compilation_cache_dir", str(compiled_folder))
        # Small programs too: hundreds of them take longer to compile than the large ones.
        jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
        jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)
        # An entry of a killed process may be cut, and stays so: JAX compiles its program anew, without harm.
        warnings.filterwarnings("ignore", r"Error \w+ persistent compilation cache entry")


def choose_code_generator() -> None:
    """Let this process and those that it starts compile in half the time, unless the user has set flags."""
    if "XLA_FLAGS" not in os.environ and version("jaxlib").startswith(TRIED_VERSIONS):
        os.environ["XLA_FLAGS"] = CODE_GENERATOR


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
