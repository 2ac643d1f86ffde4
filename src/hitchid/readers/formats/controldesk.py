"""The label rows of text that dSPACE ControlDesk exports, below which every row holds time and samples."""

from collections import Counter
from collections.abc import Sequence
from typing import NamedTuple

NAMES, UNITS, RASTERS, PATHS, SAMPLES = "trace_names", "trace_units", "raster", "path", "trace_values"
TIME = "time_s"


class Labels(NamedTuple):
    """What the label rows say.

    Attributes:
        names: of the columns, in order; the first holds labels alone.
        units: name to unit, where there is one.
        header: line of the names, from 1.
        first: line of the first sample, from 1.
    """

    names: tuple[str, ...]
    units: dict[str, str]
    header: int
    first: int


def labels_of(rows: Sequence[tuple[int, Sequence[str]]]) -> Labels | None:
    """Return what label rows say, None where a text has none.

    A name that stands twice gives way to the last part of its path. The time has no name: it is `time_s`;
    where there are several, one for each raster, `time_s/` and the raster.

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
