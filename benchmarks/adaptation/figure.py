"""Figures against their bars."""

from typing import NamedTuple


class Figure(NamedTuple):
    """A measured figure and its bar.

    Attributes:
        name: of the figure, with its unit.
        value: measured; NaN where there is none, which misses any bar.
        least, most: the bar.
    """

    name: str
    value: float
    least: float = float("-inf")
    most: float = float("inf")

    @property
    def holds(self) -> bool:
        """Whether the value is within the bar."""
        return self.least <= self.value <= self.most

    def __str__(self) -> str:
        """Return figure and bar as a line."""
        bar = f"at least {self.least:g}" if self.most == float("inf") else f"at most {self.most:g}"
        if float("-inf") < self.least and self.most < float("inf"):
            bar = f"{self.least:g} to {self.most:g}"
        return f"{self.name}: got {self.value:.4g}, expected {bar}"
