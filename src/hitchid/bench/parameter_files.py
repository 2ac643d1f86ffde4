"""Parameter sets: TOML files in which every number has a unit and a source."""

import dataclasses
from importlib import resources
from pathlib import Path

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError, create_model

from hitchid._support.precision import double_precision
from hitchid.bench.linkage import Cylinder, Friction, Linkage
from hitchid.bench.plant import Rig
from hitchid.bench.quantities import QuantityRange, to_base_unit
from hitchid.bench.sensors import CalibrationCurve, Sensors
from hitchid.bench.valves import LiftingValve, LoweringValve, Oil, Spool, Supply
from hitchid.errors import SettingsError
from hitchid.logs import describe_settings, parse_toml

CHECKED_POSITIONS = 201  # positions over the stroke at which the linkage is checked (chosen)
SETS = resources.files("hitchid.bench") / "parameters"

COMPONENTS: dict[str, tuple[type[eqx.Module], ...]] = {
    "oil": (Oil,),
    "supply": (Supply,),
    "lifting_valve": (Spool, LiftingValve),
    "lowering_valve": (Spool, LoweringValve),
    "cylinder": (Cylinder,),
    "friction": (Friction,),
    "linkage": (Linkage,),
    "sensors": (Sensors,),
}
"""Table of the file to the components whose quantities it holds."""


class Entry(BaseModel):
    """One parameter: value, unit and source."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    value: float = Field(allow_inf_nan=False)
    unit: str
    source: str = Field(min_length=1)


def _quantities(table: str) -> dict[str, QuantityRange]:
    return {
        field.name: field.metadata["range"]
        for component in COMPONENTS[table]
        for field in dataclasses.fields(component)
        if "range" in field.metadata
    }


def _model(name: str, fields: dict[str, type[BaseModel]]) -> type[BaseModel]:
    definitions: dict[str, tuple[type[BaseModel], object]] = {
        key: (kind, ...) for key, kind in fields.items()
    }
    return create_model(name, __config__=ConfigDict(extra="forbid"), **definitions)  # pyright: ignore[reportCallIssue, reportArgumentType]


RigFile = _model(
    "RigFile", {table: _model(table, dict.fromkeys(_quantities(table), Entry)) for table in COMPONENTS}
)


def parameter_sets() -> tuple[str, ...]:
    """Return the names of the parameter sets that come with the package."""
    return tuple(sorted(entry.name.removesuffix(".toml") for entry in SETS.iterdir()))


@double_precision
def load_rig(name_or_path: str | Path) -> Rig:
    """Return the rig of a parameter set that comes with the package, or of a TOML file.

    Raises:
        SettingsError: there is no such set, or a parameter is missing, unknown, without unit or source, of
            the wrong dimension, out of range, or the linkage does not close over the stroke.
    """
    name = str(name_or_path)
    try:
        # A text without the ending is a name: that of a file by mistake is told which names there are.
        if isinstance(name_or_path, str) and not name.endswith(".toml"):
            if name not in parameter_sets():
                raise SettingsError(
                    f"rig '{name}': expected one of {', '.join(parameter_sets())}, or a file *.toml"
                )
            text = (SETS / f"{name}.toml").read_text(encoding="utf-8")
        else:
            text = Path(name_or_path).read_text(encoding="utf-8")
    except (OSError, ValueError) as error:  # no text, or a path no file can have
        raise SettingsError(f"{name}: cannot be read: {error}") from error
    tables = parse_toml(text, name)
    try:
        return build_rig(tables)
    except SettingsError as error:
        raise SettingsError(f"{name}: {error}") from error


def build_rig(tables: dict[str, object]) -> Rig:
    """Return the rig of parsed tables; raises `SettingsError` as `load_rig` does."""
    try:
        parsed = RigFile.model_validate(tables).model_dump()
    except ValidationError as error:
        raise SettingsError(describe_settings(error, RigFile)) from error
    values = {
        table: {
            key: jnp.asarray(
                to_base_unit(entry["value"], entry["unit"], ranges[key], f"key '{table}.{key}'"), jnp.float64
            )
            for key, entry in parsed[table].items()
        }
        for table, ranges in ((table, _quantities(table)) for table in COMPONENTS)
    }
    # Curves belong to a rig, not to a test: drawn from its own seed, whatever is simulated with it.
    sensors = values["sensors"]
    rng, largest = np.random.default_rng(int(sensors["calibration_seed"])), float(sensors["curve_error"])
    angle, lifting, lowering = (CalibrationCurve.random(rng, largest) for _ in range(3))
    rig = Rig(
        oil=Oil(**values["oil"]),
        supply=Supply(**values["supply"]),
        lifting_valve=LiftingValve(**_with_spool(values["lifting_valve"])),
        lowering_valve=LoweringValve(**_with_spool(values["lowering_valve"])),
        cylinder=Cylinder(friction=Friction(**values["friction"]), **values["cylinder"]),
        linkage=Linkage(**values["linkage"]),
        sensors=Sensors(angle_curve=angle, lifting_curve=lifting, lowering_curve=lowering, **sensors),
    )
    # What a range of one number cannot say.
    for table in ("lifting_valve", "lowering_valve"):
        spool = getattr(rig, table).spool
        if not spool.dead_zone < spool.saturation:
            raise SettingsError(
                f"key '{table}.saturation': got {float(spool.saturation):g} A, "
                f"expected more than the dead zone, {float(spool.dead_zone):g} A"
            )
    friction = rig.cylinder.friction
    if friction.static < friction.coulomb:
        raise SettingsError(
            f"key 'friction.static': got {float(friction.static):g} N, "
            f"expected at least friction.coulomb, {float(friction.coulomb):g} N"
        )
    _check_linkage(rig)
    return rig


def _with_spool(values: dict) -> dict:
    names = {field.name for field in dataclasses.fields(Spool)}
    spool = Spool(**{key: value for key, value in values.items() if key in names})
    return {"spool": spool} | {key: value for key, value in values.items() if key not in names}


def _check_linkage(rig: Rig) -> None:
    """Refuse a linkage that opens, stalls or leaves the sensor's range anywhere on the stroke."""
    linkage, stroke = rig.linkage, float(rig.cylinder.stroke)
    positions = jnp.linspace(0.0, stroke, CHECKED_POSITIONS)
    # The cylinder first: where its triangle does not close, all that follows is no number.
    cylinder = np.asarray(linkage.cylinder_cosine(positions))
    rod = np.asarray(linkage.rod_cosine(linkage.arm_angle(positions)))
    lever = np.asarray(linkage.rates(positions)[2])
    angle, full = np.asarray(linkage.sensor_angle(positions)), float(rig.sensors.angle_range)
    rises = "the derivative dh/dx of implement height over piston displacement"
    within = (angle >= 0) & (angle <= full)
    for key, condition, values, required, satisfied in (
        ("retracted_length", "the cosine of the cylinder angle", cylinder, "(-1, 1)", np.abs(cylinder) < 1),
        ("lift_rod", "the cosine of the lift-rod angle", rod, "(-1, 1)", np.abs(rod) < 1),
        ("lift_rod", rises, lever, "(0, inf)", lever > 0),
        ("sensor_offset", "the angle at the sensor", angle, f"0 to {full:g} rad", within),
    ):
        if not np.all(satisfied):
            row = int(np.flatnonzero(~satisfied)[0])
            raise SettingsError(
                f"key 'linkage.{key}': expected {condition} in {required} over the whole "
                f"stroke, got {values[row]:g} at {float(positions[row]):g} m of the stroke"
            )
