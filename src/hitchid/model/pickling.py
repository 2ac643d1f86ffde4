"""Pickling of models: their arrays keep float64 in a process that has not switched it on."""

import pickle

from hitchid._support.precision import double_precision
from hitchid._support.records import Value, field_values, rebuild


def reduced(model: Value) -> tuple:
    """Return what `pickle` and `copy` build a model from: its fields, packed on their own."""
    return _restored, (type(model), pickle.dumps(field_values(model)))


@double_precision
def _restored(kind: type[Value], content: bytes) -> object:
    # Unpacked here, within double precision: JAX otherwise rounds the arrays to float32.
    return rebuild(kind, pickle.loads(content))  # noqa: S301 - part of a pickle that is being read
