"""Samples of one record: checked and read-only, and the fingerprint by which a test is recognised."""

import hashlib
from collections.abc import Mapping

import numpy as np

from hitchid._support import checks
from hitchid.errors import InputError
from hitchid.logs.units import UNITS, check_unit

FINGERPRINT_STEP = 1e-6  # of the range; above the rounding error of a unit conversion (chosen)


def frozen_samples(
    name: str, signals: Mapping[str, np.ndarray], units: Mapping[str, str], shape: tuple[int, ...]
) -> dict[str, np.ndarray]:
    """Return role to read-only samples.

    Args:
        name: of the record, for messages.
        signals: role to samples.
        units: role to unit.
        shape: of the displacement, which all signals must have.

    Raises:
        InputError: a signal has no known unit or another shape, or a sample is no finite number.
    """
    frozen = {}
    for role, samples in signals.items():
        array = _read_only(samples, f"record '{name}': '{role}'")
        if role not in units:
            raise InputError(f"record '{name}': '{role}' has no unit; expected one of {', '.join(UNITS)}")
        check_unit(units[role], f"record '{name}': '{role}'")
        if array.shape != shape:
            raise InputError(f"record '{name}': '{role}' has shape {array.shape}, expected {shape}")
        if not np.all(np.isfinite(array)):
            row = int(np.flatnonzero(~np.isfinite(array))[0])
            raise InputError(f"record '{name}': '{role}' is {array[row]} at sample {row}")
        frozen[role] = array
    return frozen


def fingerprint(displacement: np.ndarray, factor: float) -> str:
    """Return the SHA-256 of the shape of a displacement; see `Record.fingerprint`.

    Args:
        displacement: shape [N].
        factor: of its unit to the SI unit.
    """
    relative = displacement - displacement[0]
    peak_to_peak = float(np.ptp(relative))
    shape = relative / (peak_to_peak or 1.0)
    # The irrational offset moves round decimals away from the limits of rounding.
    steps = np.round(shape / FINGERPRINT_STEP + 1 / np.pi).astype(np.int64)
    size = f"{peak_to_peak * factor:.6e}"
    return hashlib.sha256(size.encode() + steps.tobytes()).hexdigest()


def _read_only(samples: np.ndarray, name: str) -> np.ndarray:
    """Return read-only samples: without a copy if they are read-only already."""
    base = samples if getattr(samples, "base", None) is None else samples.base
    if isinstance(base, np.ndarray) and samples.dtype == np.float64 and not base.flags.writeable:
        return samples
    try:
        array = np.array(samples, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise checks.input_error(name, "numbers", samples) from error
    array.setflags(write=False)
    return array
