"""Operating conditions of a campaign on the virtual bench: implement, oil temperature, a second consumer."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from hitchid._support import checks
from hitchid.errors import InputError
from hitchid.rig import Rig
from hitchid.rig.oil import TANK_PRESSURE_PA

LITRES_PER_MIN = 1e-3 / 60  # m³/s
PRESSURE_NOISE_BAR, OIL_NOISE_C, FLOW_NOISE_L_MIN = 0.1, 0.3, 0.1  # white noise of their sensors, rms; chosen
COVARIATES = """covariates = [
    "pressure_bar",
    { column = "oil_degC", unit = "degC" },
    { column = "consumer_l_min", unit = "l/min" },
]
"""


class Condition(NamedTuple):
    """One operating condition.

    Attributes:
        name: of its tests, such as `600kg-40C`.
        rig: the bench in this condition.
        oil_c: oil temperature, °C.
        consumer_l_min: flow that a second consumer takes from the pump, l/min.
    """

    name: str
    rig: Rig
    oil_c: float
    consumer_l_min: float

    def readings(self, pressure_pa: np.ndarray, rng: np.random.Generator) -> dict[str, np.ndarray]:
        """Return cylinder pressure above tank, oil temperature and consumer flow as measured, shape [N]."""
        true = {
            "pressure_bar": ((pressure_pa - TANK_PRESSURE_PA) / 1e5, PRESSURE_NOISE_BAR),
            "oil_degC": (self.oil_c, OIL_NOISE_C),
            "consumer_l_min": (self.consumer_l_min, FLOW_NOISE_L_MIN),
        }
        return {
            name: value + noise * rng.standard_normal(pressure_pa.size)
            for name, (value, noise) in true.items()
        }


@dataclass(frozen=True)
class Conditions:
    """Operating conditions of which every combination is tested.

    Attributes:
        implements_kg: masses of the implement, kg; empty for that of the rig.
        oil_c: oil temperatures, °C; empty for that of the rig.
        consumer_l_min: flows that a second consumer takes from the pump before the hitch, l/min.
    """

    implements_kg: tuple[float, ...] = ()
    oil_c: tuple[float, ...] = ()
    consumer_l_min: tuple[float, ...] = (0.0,)

    def of(self, rig: Rig) -> Iterator[Condition]:
        """Yield the conditions of a rig.

        Raises:
            InputError: a value is not a number, a mass not positive, or a flow not from zero to less than
                the pump's.
        """
        pump_l_min = float(rig.supply.pump_flow) / LITRES_PER_MIN
        masses = self.implements_kg or (float(rig.linkage.implement_mass),)
        temperatures = self.oil_c or (float(rig.oil.temperature),)
        for mass, oil_c, consumer in product(masses, temperatures, self.consumer_l_min):
            checks.number(mass, "implements_kg", above=0.0)
            checks.number(oil_c, "oil_c")
            if not 0 <= checks.number(consumer, "consumer_l_min") < pump_l_min:
                raise InputError(
                    f"consumer_l_min: expected from 0 to less than the pump's {pump_l_min:.4g} l/min, "
                    f"got {consumer:g}"
                )
            values = (mass, oil_c, (pump_l_min - consumer) * LITRES_PER_MIN)
            changed = eqx.tree_at(
                lambda rig: (rig.linkage.implement_mass, rig.oil.temperature, rig.supply.pump_flow),
                rig,
                tuple(map(jnp.asarray, values)),
            )
            flow = f"-{consumer:g}lpm" if self.consumer_l_min != (0.0,) else ""
            yield Condition(f"{mass:g}kg-{oil_c:g}C{flow}", changed, oil_c, consumer)
