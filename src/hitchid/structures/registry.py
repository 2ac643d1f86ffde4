"""The structures by name: a new one is one file and one line here."""

from types import MappingProxyType

from hitchid.errors import InputError
from hitchid.structures.cascaded_tanks import CascadedTanks
from hitchid.structures.first_order_lag import FirstOrderLag
from hitchid.structures.inertia_with_friction import InertiaWithFriction
from hitchid.structures.integrator import Integrator
from hitchid.structures.integrator_first_order import IntegratorFirstOrder
from hitchid.structures.integrator_second_order import IntegratorSecondOrder
from hitchid.structures.structure import Structure

STRUCTURES = MappingProxyType(
    {
        structure.name: structure
        for structure in (
            IntegratorSecondOrder(),
            FirstOrderLag(),
            IntegratorFirstOrder(),
            Integrator(),
            InertiaWithFriction(),
            CascadedTanks(),
        )
    }
)


def structure_named(name: str) -> Structure:
    """Return a structure by its name.

    Raises:
        InputError: there is none of that name.
    """
    if name not in STRUCTURES:
        raise InputError(f"there is no structure '{name}'; required one of {', '.join(STRUCTURES)}")
    return STRUCTURES[name]
