"""Registry of the baselines that are fitted for each channel; a new one is one file and one line here."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from hitchid._support.extensions import with_extensions
from hitchid.baselines.baseline import Baseline, FittedBaseline
from hitchid.baselines.black_box import BlackBoxBaseline
from hitchid.baselines.linear import ArxBaseline
from hitchid.baselines.narx import NarxBaseline
from hitchid.baselines.output_error import OutputErrorBaseline
from hitchid.errors import InputError
from hitchid.structures import Batch

# Persistence baseline: the last measured displacement is the prediction.


class Persistence(FittedBaseline):
    """y(k) = y(k−h); in free run y(k) = y(0). It has no parameters and is not stored."""

    def free_run(self, batch: Batch) -> Float[np.ndarray, "t n"]:
        """Return the initial displacement at every sample, shape [T, N]."""
        return np.broadcast_to(np.asarray(batch.initial)[:, None], batch.command.shape)

    def predict(self, batch: Batch, horizons: Sequence[int]) -> list[Float[np.ndarray, "t n"]]:
        """Return for each h the displacement measured h samples before, shape [T, N]."""
        measured = np.asarray(batch.displacement)
        return [delayed(measured, h) for h in horizons]


def delayed(rows: Float[np.ndarray, "t n"], samples: int) -> Float[np.ndarray, "t n"]:
    """Return rows delayed by a number of samples; the first samples are not changed."""
    return np.concatenate([rows[:, :samples], rows[:, :-samples]], axis=1)


BASELINES = (ArxBaseline(), OutputErrorBaseline(), NarxBaseline(), BlackBoxBaseline())


def all_baselines() -> Mapping[str, Baseline]:
    """Return name to baseline: those of this package, then those of the entry points `hitchid.baselines`.

    Raises:
        InputError: an entry point cannot be imported, is not a `Baseline`, or its name is taken.
    """
    return with_extensions("hitchid.baselines", BASELINES, kind=Baseline, name=lambda baseline: baseline.name)


def baseline_named(name: str) -> Baseline:
    """Return the baseline of a name.

    Raises:
        InputError: no baseline has that name, or as `all_baselines`.
    """
    baselines = all_baselines()
    if name not in baselines:
        raise InputError(f"baseline: expected one of {', '.join(baselines)}, got '{name}'")
    return baselines[name]
