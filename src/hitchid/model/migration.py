"""Descriptions of model folders that earlier versions wrote, brought to what this one reads."""

from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any

Description = dict[str, Any]
SCHEMA = 5


def _with_hold(content: Description) -> Description:
    """Schema 4 knows how a held piston creeps, and whether two modes are needed."""
    return {**content, "drift": 0.0, "two_modes": None}


def _with_uncertainty(content: Description) -> Description:
    """Schema 5 knows how far each channel can be trusted."""
    return {**content, "uncertainty": {}}


MIGRATIONS: Mapping[int, Callable[[Description], Description]] = MappingProxyType(
    {3: _with_hold, 4: _with_uncertainty}
)
"""From a schema to the next: what an older model did not know is told as not known."""


def is_readable(schema: object) -> bool:
    """Tell whether a description of a schema is one of this version or can be brought to it."""
    return type(schema) is int and (schema == SCHEMA or schema in MIGRATIONS)


def migrate(content: Description) -> Description:
    """Return a description in the schema of this version, step by step from its own."""
    while content["schema"] in MIGRATIONS:
        schema = content["schema"]
        content = {**MIGRATIONS[schema](content), "schema": schema + 1}
    return content
