"""Optional parts of a result: a part that fails is left out, with a notice."""

from collections.abc import Callable
from typing import TypeVar

from hitchid.errors import OutputError

Result = TypeVar("Result")


def attempt(description: str, compute: Callable[[], Result], notices: list[str]) -> Result | None:
    """Compute an optional part of a result.

    Args:
        description: what it is, for the notice.
        compute: computes it.
        notices: gets a sentence where the part fails.

    Returns:
        The part; None where it failed, for whatever cause.

    Raises:
        OutputError: a checkpoint cannot be written, as on a full disk.
    """
    try:
        return compute()
    except OutputError:
        raise
    except Exception as error:
        cause = str(error) or "no message"
        notices.append(f"could not be computed: {description} ({type(error).__name__}: {cause})")
        return None
