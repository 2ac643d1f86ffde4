"""`hitchid run`: online prediction, sample by sample from standard input."""

import os
import signal
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from hitchid._support.files import check_folder, lines
from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.errors import InputError

if TYPE_CHECKING:
    from hitchid.live import Event, Live

REHEARSAL_S = 2e-3  # s before a sample is due; a rehearsal takes about half of it (measured)


def run(
    model: options.ModelFolder,
    initial: Annotated[
        float | None,
        typer.Option("--initial", help="Initial displacement, in the model's unit [first measured]."),
    ] = None,
    load: options.Loads = None,
    adapt: Annotated[
        bool, typer.Option("--adapt", help="Follow a machine that changes, stroke by stroke.")
    ] = False,
    changes: Annotated[
        Path | None,
        typer.Option(
            "--changes", help="Change log (JSON lines); goes on from an existing one.", show_default=False
        ),
    ] = None,
    save: Annotated[
        Path | None,
        typer.Option("--save", help="Folder for the adapted model at the end.", show_default=False),
    ] = None,
    force: options.Force = False,
) -> None:
    """Read samples from standard input, line by line; write the displacement one sample later (JSON)."""
    if not adapt and (changes is not None or save is not None):
        raise InputError("--changes and --save are for adaptation; give --adapt, too")
    prepare_jax()
    from hitchid.cli.terminal import show_adaptation
    from hitchid.live import ChangeLog, Live, OnlineAdaptation
    from hitchid.model import load as load_model
    from hitchid.model import save as save_model
    from hitchid.model.folder import MODEL_FILE

    if save is not None:
        check_folder(save, result_kind=MODEL_FILE, force=force)
    identified, loads = load_model(model), options.loads_of(load)
    with ExitStack() as stack:
        adaptation = None
        counts: Counter[tuple[str, str]] = Counter()
        if adapt:
            log = None if changes is None else stack.enter_context(closing(ChangeLog(changes, identified)))

            def take(event: "Event") -> None:
                counts[event.direction, event.kind] += 1
                if log is not None:
                    log.write(event)

            adaptation = OnlineAdaptation(
                identified, load=loads, log=take, earlier=log.earlier if log else ()
            )
        live = Live(identified, initial=initial, load=loads, adaptation=adaptation)
        if adaptation is None:
            _answer_lines(live, identified.step_s)
        else:
            with _ctrl_c_ends_input():
                _answer_lines(live, identified.step_s)
            adaptation.finish()
            show_adaptation(identified, adaptation.changes, counts)
            if save is not None:
                save_model(adaptation.model, save, force=force)


@contextmanager
def _ctrl_c_ends_input() -> Iterator[None]:
    """Let Ctrl-C end the input instead of the program, a second one end the program."""
    # The thread behind it ends the program soon after Ctrl-C; what is learned and saved may take longer.
    wakeup, is_ended = signal.set_wakeup_fd(-1), False

    def end(*_: object) -> None:
        nonlocal is_ended
        is_ended = True
        os.dup2(os.open(os.devnull, os.O_RDONLY), sys.stdin.fileno())
        restore()

    def restore() -> None:
        signal.signal(signal.SIGINT, usual)
        signal.set_wakeup_fd(wakeup, warn_on_full_buffer=False)

    usual = signal.signal(signal.SIGINT, end)
    try:
        yield
    except BrokenPipeError:  # in a pipe, Ctrl-C ends who reads the answers as well
        if not is_ended:
            raise
    finally:
        restore()


def _answer_lines(live: "Live", step_s: float) -> None:
    """Answer each line of standard input with one of standard output."""
    sys.stderr.write("ready\n")
    sys.stderr.flush()
    for line in lines(sys.stdin, step_s - REHEARSAL_S, live.rehearse):
        sys.stdout.write(live.process(line).to_json() + "\n")
        sys.stdout.flush()
        live.learn()
