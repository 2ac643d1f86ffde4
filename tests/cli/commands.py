"""The program within the process of the tests, as its entry point runs it."""

import sys
from contextlib import redirect_stderr, redirect_stdout
from io import StringIO
from typing import NamedTuple

import pytest

from hitchid import cli


class Result(NamedTuple):
    """What a run of the program left behind."""

    code: int
    out: str
    err: str


def hitchid(*arguments, stdin="") -> Result:
    """Run the program with arguments and what it reads on standard input."""
    out, err, code = StringIO(), StringIO(), 0
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", ["hitchid", *map(str, arguments)])
        patch.setattr(sys, "stdin", StringIO(stdin))
        try:
            cli.main()
        except SystemExit as done:
            code = done.code or 0
    return Result(code, out.getvalue(), err.getvalue())
