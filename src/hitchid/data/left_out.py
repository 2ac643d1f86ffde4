"""Tests that cannot be used: left out with the reason; in strict mode an error."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import NoReturn, TypeVar

from hitchid._support.notices import Notice, Severity
from hitchid._support.values import Value
from hitchid.errors import InputError, LogError, SettingsError

Item = TypeVar("Item")
Result = TypeVar("Result")
MAX_SHOWN = 10  # causes named in one error message (chosen)


@dataclass(frozen=True, eq=False)
class LeftOut(Value):
    """A log or test that is not used.

    Attributes:
        name: of the log or test.
        error: the reason, as an exception.
    """

    name: str
    error: InputError

    @property
    def reason(self) -> str:
        """The reason, without the name."""
        return self.error.reason if isinstance(self.error, LogError) else str(self.error)

    def describe(self) -> dict[str, str]:
        """Return name and reason for JSON output."""
        return {"name": self.name, "reason": self.reason}


def split_usable(
    items: Iterable[tuple[str, Item]], work: Callable[[Item], Result], *, strict: bool
) -> tuple[list[Result], list[LeftOut]]:
    """Return the results of usable items, and the items that cannot be used.

    Args:
        items: name and item.
        work: raises `InputError` for an item that cannot be used.
        strict: whether the first such item is an error for all.

    Raises:
        SettingsError: a settings file is wrong.
        InputError: with `strict`, an item cannot be used.
    """
    usable, left_out = [], []
    for name, item in items:
        try:
            usable.append(work(item))
        except SettingsError:
            raise
        except InputError as error:
            if strict:
                raise
            left_out.append(LeftOut(name, error.with_traceback(None)))
    return usable, left_out


def left_out_notices(left_out: Sequence[LeftOut], total: int, what: str) -> tuple[Notice, ...]:
    """Return a notice for each reason with the names concerned, and one with the count.

    Args:
        left_out: the items that are not used.
        total: number of all items.
        what: kind of item, such as `logs`.
    """
    if not left_out:
        return ()
    names: dict[str, list[str]] = {}
    for item in left_out:
        names.setdefault(item.reason, []).append(item.name)
    notices = [
        Notice("left-out", f"left out: {reason}", ", ".join(affected), Severity.WARNING)
        for reason, affected in names.items()
    ]
    count = f"{len(left_out)} of {total} {what} left out"
    return (*notices, Notice("left-out-count", count, severity=Severity.WARNING))


def refuse(left_out: Sequence[LeftOut], what: str) -> NoReturn:
    """Raise an error if no item can be used: the common cause, else all causes.

    Raises:
        InputError: always; the first item's own error where all have the same.
    """
    if len({item.reason for item in left_out}) == 1:
        raise left_out[0].error
    causes = [f"{item.name}: {item.reason}" for item in left_out[:MAX_SHOWN]]
    more = [f"and {len(left_out) - MAX_SHOWN} more"] if len(left_out) > MAX_SHOWN else []
    raise InputError(f"none of the {len(left_out)} {what} can be used: {'; '.join([*causes, *more])}")
