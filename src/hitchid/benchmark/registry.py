"""The structures by name: a new one is one file and one line here."""

from types import MappingProxyType

from hitchid.benchmark.cascaded_tanks import CascadedTanks
from hitchid.benchmark.first_order_lag import FirstOrderLag
from hitchid.benchmark.inertia_with_friction import InertiaWithFriction
from hitchid.benchmark.integrator import Integrator
from hitchid.benchmark.integrator_first_order import IntegratorFirstOrder
from hitchid.benchmark.integrator_second_order import IntegratorSecondOrder
from hitchid.benchmark.structure import Structure
from hitchid.errors import InputError

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
