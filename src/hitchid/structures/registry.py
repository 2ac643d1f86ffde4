"""The structures by name: a new one is one file and one line here, or an entry point of another package."""

from collections.abc import Mapping

from hitchid._support.extensions import with_extensions
from hitchid.errors import InputError
from hitchid.structures.linear_structures import (
    FirstOrderLag,
    Integrator,
    IntegratorFirstOrder,
    IntegratorSecondOrder,
    IntegratorSecondOrderFriction,
    IntegratorSecondOrderStroke,
)
from hitchid.structures.nonlinear_structures import CascadedTanks, InertiaWithFriction
from hitchid.structures.structure import Structure

BUILT_IN = (
    IntegratorSecondOrder(),
    IntegratorSecondOrderFriction(),
    IntegratorSecondOrderStroke(),
    FirstOrderLag(),
    IntegratorFirstOrder(),
    Integrator(),
    InertiaWithFriction(),
    CascadedTanks(),
)


def registered_structures() -> Mapping[str, Structure]:
    """Return the structures of this and of other installed packages by name.

    Raises:
        InputError: a structure of another package cannot be imported, is of another type, or has a name that
            is taken.
    """
    return with_extensions("hitchid.structures", BUILT_IN, kind=Structure, name=lambda part: part.name)


def external_structures() -> tuple[Structure, ...]:
    """Return the structures of other installed packages; raises as `registered_structures`."""
    return tuple(registered_structures().values())[len(BUILT_IN) :]


def structure_named(name: str) -> Structure:
    """Return a structure by its name.

    Raises:
        InputError: there is none of that name, or as `registered_structures`.
    """
    for structure in BUILT_IN:
        if structure.name == name:
            return structure
    structures = registered_structures()
    if name not in structures:
        raise InputError(f"there is no structure '{name}'; expected one of {', '.join(structures)}")
    return structures[name]
