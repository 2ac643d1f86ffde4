"""Numbers of a file that may come from a stranger: types with the bounds that pydantic checks."""

from typing import Annotated

from pydantic import Field

MAX_MAGNITUDE = 1e9  # a command or displacement beyond it, in its unit, is taken as missing; chosen
SMALLEST = 1e-12  # of a parameter or a scale that is positive, in its unit; chosen
LARGEST_FACTOR = 1e30  # of a band: where held-out tests hardly differ from the ensemble it is beyond 1e10
ROUNDING = 1e-6  # by which a correlation may be beyond ±1

Number = Annotated[float, Field(gt=-MAX_MAGNITUDE, lt=MAX_MAGNITUDE)]
Error = Annotated[float, Field(ge=0)]  # of a simulation, which may have diverged
Size = Annotated[float, Field(ge=0, lt=MAX_MAGNITUDE)]
Positive = Annotated[float, Field(ge=SMALLEST, lt=MAX_MAGNITUDE)]
Factor = Annotated[float, Field(ge=0, le=LARGEST_FACTOR)]
FromOne = Annotated[float, Field(ge=1, lt=MAX_MAGNITUDE)]
Figure = Annotated[float, Field(ge=-LARGEST_FACTOR, le=LARGEST_FACTOR)]
LogFactor = Annotated[float, Field(ge=-100, le=100)]  # natural logarithm of a factor
Share = Annotated[float, Field(ge=0, le=1)]
Level = Annotated[float, Field(ge=SMALLEST, le=1 - SMALLEST)]
Correlation = Annotated[float, Field(ge=-1 - ROUNDING, le=1 + ROUNDING)]
Count = Annotated[int, Field(ge=0, le=2**53)]
CountFromOne = Annotated[int, Field(ge=1, le=10**9)]
