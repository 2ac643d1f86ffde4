"""Everything `hitchid` raises on purpose.

HitchError                  the root: catch this one to catch them all
├── InputError              what was handed in cannot be used (exit code 2)
│   ├── LogError            a log: names the file, the line, the column
│   ├── SettingsError       `campaign.toml` or a settings file: names the key
│   ├── ModelFolderError    a model folder that is cut short, edited or too new
│   └── OutputError         a place to write that is taken or cannot be written
└── FitError                an identification that could not be carried out (exit code 1)
"""

from functools import partial

from hitchid._support.inert import printable


class HitchError(Exception):
    """The root of everything this package raises on purpose; its message is printable, whatever it names."""

    def __str__(self) -> str:
        return printable(super().__str__())


class InputError(HitchError):
    """An input cannot be used: the message names the value and the requirement."""


class LogError(InputError):
    """A log cannot be used; the message names the file and, where known, line and column."""

    def __init__(self, source: object, problem: str, *, line: int | None = None, column: str | None = None):
        """Compose `source: line N: column 'C': problem`, leaving out what is not known."""
        self.source, self.problem, self.line, self.column = source, problem, line, column
        location = []
        if line is not None:
            location.append(f"line {line}")
        if column is not None:
            location.append(f"column '{column}'")
        self.reason = ": ".join([*location, problem])
        super().__init__(f"{source}: {self.reason}")

    def __reduce__(self) -> tuple:
        """Return the constructor with its arguments, for `pickle` and `copy`."""
        return partial(type(self), line=self.line, column=self.column), (self.source, self.problem)


class SettingsError(InputError):
    """A settings file is wrong; the message names the key."""


class ModelFolderError(InputError):
    """A model folder is incomplete, was edited, or was written by a newer version."""


class OutputError(InputError):
    """A result cannot be written to the requested place."""


class FitError(HitchError):
    """The identification could not be carried out on these data."""
