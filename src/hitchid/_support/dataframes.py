"""Tables as pandas DataFrames; pandas is imported only where one is requested."""

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

from hitchid.errors import InputError

if TYPE_CHECKING:
    from pandas import DataFrame


def dataframe(rows: Sequence[Mapping[str, object]]) -> "DataFrame":
    """Return rows, each column name to value, as a DataFrame; None becomes a missing value.

    Raises:
        InputError: pandas is not installed.
    """
    try:
        import pandas as pd
    except ImportError as error:
        raise InputError("to_dataframe: expected pandas to be installed; run: pip install pandas") from error
    return pd.DataFrame(list(rows))
