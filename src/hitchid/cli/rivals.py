"""`hitchid rivals`: models of other kinds, trained on the tests of a model, beside it."""

from hitchid._support.jax_setup import prepare_jax
from hitchid.cli import options
from hitchid.cli.program import with_search_cache
from hitchid.errors import OutputError


def rivals(
    model: options.ModelFolder,
    logs: options.Logs,
    signals: options.Signals = None,
    strict: options.Strict = False,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> None:
    """Train the rivals of a model on the tests that it was identified from; validate then compares them.

    OE, NARX, a black-box LSTM, the paper's grey box and the searches of the parameters. The model itself
    stays as it is, bit for bit.
    """
    from hitchid._support.files import check_folder
    from hitchid.cli import terminal as display

    prepare_jax()
    from hitchid.estimation import SearchComparison
    from hitchid.identification import train_rivals
    from hitchid.model import load, load_trace, save

    hitch, trace = load(model), load_trace(model)
    if hitch.has_trained_rivals and not force:
        raise OutputError(f"{model}: has trained rivals already; --force trains them again")
    # Before the training: a folder that was changed by hand is not replaced.
    check_folder(model, result_kind="model.json", force=True)
    campaign = display.read_campaign(logs, signals=signals, strict=strict, quiet=quiet)
    with display.progress(quiet=quiet) as report:
        hitch = train_rivals(hitch, campaign, searches=with_search_cache(SearchComparison()), progress=report)
    save(hitch, model, trace=trace, force=True)
    if not quiet:
        for direction, of_direction in hitch.rivals.items():
            display.write_messages(f"{direction}, notice", of_direction.notices)
        display.write_result(model, "rivals trained; hitchid validate compares them")
