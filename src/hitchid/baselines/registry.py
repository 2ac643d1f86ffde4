"""The baselines that are fitted beside a channel; another one is one file and one line here."""

from collections.abc import Mapping

from hitchid._support.extensions import with_extensions
from hitchid.baselines.arx import ArxBaseline
from hitchid.baselines.baseline import Baseline
from hitchid.baselines.black_box import BlackBoxBaseline
from hitchid.baselines.narx import NarxBaseline
from hitchid.errors import InputError

BASELINES = (ArxBaseline(), NarxBaseline(), BlackBoxBaseline())


def all_baselines() -> Mapping[str, Baseline]:
    """Return name to baseline: those of this package, then those that other packages register.

    Raises:
        InputError: a registered baseline cannot be imported, is none, or its name is taken.
    """
    return with_extensions("hitchid.baselines", BASELINES, kind=Baseline, name=lambda baseline: baseline.name)


def baseline_named(name: str) -> Baseline:
    """Return the baseline of a name.

    Raises:
        InputError: no installed package has one of that name.
    """
    baselines = all_baselines()
    if name not in baselines:
        raise InputError(f"baseline: required one of {', '.join(baselines)}, came '{name}'")
    return baselines[name]
