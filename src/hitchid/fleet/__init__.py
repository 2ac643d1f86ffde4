"""A fleet: many machines identified, compared and watched; the entry point is `identify_fleet`.

A worker has its core before it imports NumPy or JAX; so names are imported where they are first used.
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hitchid.fleet.comparison import FleetComparison as FleetComparison
    from hitchid.fleet.comparison import compare_fleet as compare_fleet
    from hitchid.fleet.jobs import identify_fleet as identify_fleet
    from hitchid.fleet.jobs import ranked as ranked
    from hitchid.fleet.jobs import validate_fleet as validate_fleet
    from hitchid.fleet.ledger import load_model as load_model
    from hitchid.fleet.ledger import newest as newest
    from hitchid.fleet.ledger import read_rows as read_rows
    from hitchid.fleet.parameters import Metadata as Metadata
    from hitchid.fleet.parameters import read_metadata as read_metadata
    from hitchid.fleet.row import Cost as Cost
    from hitchid.fleet.row import DirectionRow as DirectionRow
    from hitchid.fleet.row import DriftRow as DriftRow
    from hitchid.fleet.row import Row as Row
    from hitchid.fleet.row import ValidationRow as ValidationRow
    from hitchid.fleet.runners import FleetProgress as FleetProgress
    from hitchid.fleet.runners import FleetResult as FleetResult
    from hitchid.fleet.runners import Runner as Runner
    from hitchid.fleet.store import Store as Store
    from hitchid.fleet.store import StoreError as StoreError

_NAMES = {
    "comparison": ("FleetComparison", "compare_fleet"),
    "jobs": ("identify_fleet", "ranked", "validate_fleet"),
    "ledger": ("load_model", "newest", "read_rows"),
    "parameters": ("Metadata", "read_metadata"),
    "row": ("Cost", "DirectionRow", "DriftRow", "Row", "ValidationRow"),
    "runners": ("FleetProgress", "FleetResult", "Runner"),
    "store": ("Store", "StoreError"),
}
_HOME = {name: module for module, names in _NAMES.items() for name in names}


def __getattr__(name: str) -> object:
    """Import a public name where it is first used."""
    if name not in _HOME:
        raise AttributeError(f"module 'hitchid.fleet' has no attribute '{name}'")
    return getattr(import_module(f"hitchid.fleet.{_HOME[name]}"), name)


def __dir__() -> list[str]:
    return sorted(_HOME)
