"""Versions of the packages that results depend on."""

from importlib.metadata import PackageNotFoundError, version

PACKAGES = ("hitchid", "jax", "jaxlib", "equinox", "optax", "numpy", "scipy")


def installed_versions() -> dict[str, str]:
    """Return package to version of the packages that results depend on."""

    def installed(package: str) -> str:
        try:
            return version(package)
        except PackageNotFoundError:
            return "unknown"

    return {package: installed(package) for package in PACKAGES}
