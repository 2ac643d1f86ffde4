"""Errors of settings as sentences: the key, what was expected, what was found."""

from collections.abc import Iterator, Mapping
from difflib import get_close_matches
from types import MappingProxyType
from typing import get_args

from pydantic import BaseModel, ValidationError

MAX_SHOWN, MAX_PRINTED = 200, 10**100  # characters, largest integer in a message (chosen)
EXPECTED: Mapping[str, str] = MappingProxyType(
    {
        "bool_parsing": "true or false",
        "bool_type": "true or false",
        "dataclass_type": "a table",
        "dict_type": "a table",
        "finite_number": "a finite number",
        "float_parsing": "a number",
        "float_type": "a number",
        "frozen_set_type": "a list",
        "greater_than": "a number above {gt:g}",
        "greater_than_equal": "at least {ge:g}",
        "int_from_float": "a whole number",
        "int_parsing": "a whole number",
        "int_parsing_size": "a smaller whole number",
        "int_type": "a whole number",
        "less_than": "a number below {lt:g}",
        "less_than_equal": "at most {le:g}",
        "list_type": "a list",
        "json_invalid": "JSON of at most 200 levels",
        "literal_error": "{expected}",
        "mapping_type": "a table",
        "missing": "a value",
        "missing_argument": "a value",
        "model_attributes_type": "a table",
        "model_type": "a table",
        "string_pattern_mismatch": "text like {pattern}",
        "string_type": "text in quotes",
        "too_long": "at most {max_length} entries",
        "too_short": "at least {min_length} entries",
        "tuple_type": "a list",
        "union_tag_invalid": "{discriminator} to be one of {expected_tags}",
        "union_tag_not_found": "the key {discriminator}",
    }
)
"""Type of a pydantic error to what was expected, with fields of its context."""


def describe(error: ValidationError, model: type[BaseModel] | None = None) -> str:
    """Return the first error of a validation as one sentence that names the key.

    Args:
        error: of the validation.
        model: the validated model, whose keys are compared with one that is not known.
    """
    first = error.errors()[0]
    kind, location = first["type"], first["loc"]
    key = _truncated(".".join(map(str, location)) or "settings")
    if kind in ("extra_forbidden", "unexpected_keyword_argument"):
        return f"key '{key}' is not known{_suggestion(str(location[-1]), location[:-1], model)}"
    value, context = first.get("input"), first.get("ctx", {})
    if kind == "value_error":  # the sentence of a validator of this package, which may name the value itself
        if not location:  # of the whole file: the sentence names the key
            return str(context["error"])
        return f"key '{key}': {context['error']}{_received(value) if _is_scalar(value) else ''}"
    expected = EXPECTED.get(kind, "another value").format_map(context)
    return (
        f"key '{key}': expected {expected}{', got none' if kind.startswith('missing') else _received(value)}"
    )


def _suggestion(name: str, location: tuple[int | str, ...], model: type[BaseModel] | None) -> str:
    """Return the nearest known key, else all known keys, else nothing."""
    known = _keys_at(model, location)
    nearest = get_close_matches(name, known, n=1)
    if nearest:
        return f"; did you mean '{nearest[0]}'?"
    return f"; expected one of {', '.join(known)}" if known else "; check its spelling"


def _keys_at(model: type[BaseModel] | None, location: tuple[int | str, ...]) -> tuple[str, ...]:
    """Return the keys of the table at a place in the settings; empty if they cannot be found."""
    for part in location:
        if model is None:
            return ()
        if isinstance(part, str):  # a number is a place in a list of tables
            field = model.model_fields.get(part)
            model = None if field is None else next(_models_in(field.annotation), None)
    return () if model is None else tuple(model.model_fields)


def _models_in(annotation: object) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in get_args(annotation):
        yield from _models_in(argument)


def _is_scalar(value: object) -> bool:
    return isinstance(value, str | int | float | bool)


def _received(value: object) -> str:
    if _is_scalar(value) or value is None:
        return f", got {_printed(value)}"
    return ", got a table" if isinstance(value, Mapping) else ", got a list"


def _truncated(text: str) -> str:
    return text if len(text) <= MAX_SHOWN else f"{text[:MAX_SHOWN]}…"


def _printed(value: object) -> str:
    if isinstance(value, bool):
        return "true" if value else "false"  # as in TOML
    if value is None:
        return "null"  # as in JSON; TOML has none
    # Python prints no integer above 4300 digits; TOML allows longer ones in hexadecimal.
    if isinstance(value, int) and abs(value) >= MAX_PRINTED:
        return "a huge number"
    return _truncated(repr(value))
