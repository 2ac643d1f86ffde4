"""Grey-box models of lifting and lowering hydraulics, identified from bench logs.

campaign = hitchid.read("logs")
found = hitchid.identify(campaign)
found.save("model")
print(hitchid.validate(hitchid.load("model"), campaign).markdown())
"""

from importlib import import_module
from typing import TYPE_CHECKING

from hitchid.errors import HitchError as HitchError

if TYPE_CHECKING:
    from hitchid.hmi.headless import campaign as campaign
    from hitchid.identification import identify as identify
    from hitchid.identification import identify_many as identify_many
    from hitchid.identification import train_rivals as train_rivals
    from hitchid.identification.cross_validation import cross_validate as cross_validate
    from hitchid.logs import read as read
    from hitchid.logs.campaign import Campaign as Campaign
    from hitchid.logs.record import Record as Record
    from hitchid.model import Hitch as Hitch
    from hitchid.model import load as load
    from hitchid.model import save as save
    from hitchid.validation import compare as compare
    from hitchid.validation import validate as validate

    __version__: str

_HOME = {
    "Campaign": "hitchid.logs.campaign",
    "Hitch": "hitchid.model",
    "Record": "hitchid.logs.record",
    "campaign": "hitchid.hmi.headless",
    "compare": "hitchid.validation",
    "cross_validate": "hitchid.identification.cross_validation",
    "identify": "hitchid.identification",
    "identify_many": "hitchid.identification",
    "load": "hitchid.model",
    "read": "hitchid.logs",
    "save": "hitchid.model",
    "train_rivals": "hitchid.identification",
    "validate": "hitchid.validation",
}

# Packages of the reference that `import hitchid` gives, as `hitchid.export.to_c`.
_PACKAGES = (
    "bench",
    "control",
    "errors",
    "estimation",
    "export",
    "fleet",
    "handover",
    "identification",
    "live",
    "logs",
    "model",
    "report",
    "structures",
    "uncertainty",
    "validation",
)

__all__ = [
    "Campaign",
    "Hitch",
    "HitchError",
    "Record",
    "__version__",
    "campaign",
    "compare",
    "cross_validate",
    "identify",
    "identify_many",
    "load",
    "read",
    "save",
    "train_rivals",
    "validate",
]


def __getattr__(name: str) -> object:
    """Import a public name or package where it is first used, so that `import hitchid` stays light."""
    if name == "__version__":
        return import_module("importlib.metadata").version("hitchid")
    if name in _PACKAGES:
        return import_module(f"hitchid.{name}")
    if name not in _HOME:
        raise AttributeError(
            f"module 'hitchid' has no attribute '{name}'; expected one of {', '.join((*__all__, *_PACKAGES))}"
        )
    return getattr(import_module(_HOME[name]), name)


def __dir__() -> list[str]:
    return sorted(__all__)
