"""Registry of the baselines that are fitted for each channel; a new one is one file and one line here."""

from collections.abc import Mapping

from hitchid._support.extensions import with_extensions
from hitchid.baselines.arx import ArxBaseline
from hitchid.baselines.baseline import Baseline
from hitchid.baselines.black_box import BlackBoxBaseline
from hitchid.baselines.narx import NarxBaseline
from hitchid.baselines.output_error import OutputErrorBaseline
from hitchid.errors import InputError

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
