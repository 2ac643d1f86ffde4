"""The label rows above the samples in text exported by dSPACE ControlDesk."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

# First cells of the label rows.
NAMES, UNITS, RASTERS, PATHS, SAMPLES = "trace_names", "trace_units", "raster", "path", "trace_values"
TIME = "time_s"  # name given to the time, which has none in the file


class Labels(NamedTuple):
    """Content of the label rows.

    Attributes:
        names: of the columns, in order; the first column holds the labels.
        units: name to unit, for columns with a unit.
        header: line of the names, from 1.
        first: line of the first sample, from 1.
    """

    names: tuple[str, ...]
    units: dict[str, str]
    header: int
    first: int


def labels_of(rows: Sequence[tuple[int, Sequence[str]]]) -> Labels | None:
    """Return the content of the label rows, None for a text without them.

    A name that occurs twice is replaced by the last part of its path. The time is named `time_s`, and
    `time_s/` with the raster if there is a time for each of several rasters.

    Args:
        rows: line and cells of the first rows of a text.
    """
    labelled = {cells[0]: (line, cells) for line, cells in rows if cells and cells[0]}
    if NAMES not in labelled or SAMPLES not in labelled:
        return None
    header, first = labelled[NAMES][0], labelled[SAMPLES][0]
    width = len(labelled[SAMPLES][1])

    def cells(label: str) -> list[str]:
        row = labelled[label][1] if label in labelled else ()
        return [*row, *[""] * width][:width]

    column_names = cells(NAMES)
    count = Counter(column_names[1:])
    names = [""]
    for name, path, raster in list(zip(column_names, cells(PATHS), cells(RASTERS), strict=True))[1:]:
        if name:
            names.append(path.rpartition("/")[2] or name if count[name] > 1 else name)
        else:
            names.append(TIME if count[""] == 1 else f"{TIME}/{raster}")
    units = {name: "s" for name in names if name.startswith(TIME)}
    units |= {name: unit for name, unit in zip(names, cells(UNITS), strict=True) if name and unit}
    return Labels(tuple(names), units, header, first)
