"""Every example of README.md and docs/ is run as it is written, page by page."""

import json
import os
import re
import shlex
import shutil
import tomllib
from collections.abc import Iterator
from functools import partial
from itertools import takewhile
from pathlib import Path
from typing import NamedTuple

import pytest
from markdown_it import MarkdownIt
from typer.testing import CliRunner

import hitchid
from hitchid import cli
from hitchid.data.signal_map import read_campaign_file
from hitchid.errors import InputError
from hitchid.identification import identify, read_settings
from hitchid.validation import read_limits

ROOT = Path(__file__).parents[2]
TUTORIAL = "docs/tutorial.md"
# Told to the reader, not run here.
ELSEWHERE = ("pip install ", "make ", "recorder | ")
DIRECTIVES = ("{toctree}", "{figure}", "{include}", "{eval-rst}", "{command-line}")
ALSO_SET = {"can", "signals", "split", "tests"}
LEFT_OUT = "…"
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")
COLUMNS = 120


class Block(NamedTuple):
    """A fenced block: its language, the file it is to be put into if any, its text and where it stands."""

    language: str
    file: str | None
    text: str
    place: str


class Command(NamedTuple):
    """A line of a console: what is asked, the exit code that is said, what is printed below it."""

    line: str
    code: int
    shown: tuple[str, ...]


def blocks(page: str) -> list[Block]:
    """Return the fenced blocks of a page that are no directives."""
    found = []
    text = (ROOT / page).read_text(encoding="utf-8")
    for token in MarkdownIt("commonmark").parse(text):
        place = f"{page}:{token.map[0] + 1}" if token.map else page
        assert token.type != "code_block" or page == "README.md", f"{place}: not fenced, so nobody runs it"
        if token.type == "fence" and not token.info.startswith(DIRECTIVES):
            found.append(block(token.info, token.content, place))
    return found


def block(info: str, text: str, place: str) -> Block:
    """Return one block; its file is said by `:caption:`, or in TOML by a comment at its top."""
    language, file = info.removeprefix("{code-block}").strip(), None
    if info.startswith("{code-block}"):
        options = list(takewhile(lambda line: line.startswith(":"), text.splitlines(keepends=True)))
        text = text[sum(map(len, options)) :].lstrip("\n")
        file = next((o.removeprefix(":caption:").strip() for o in options if o.startswith(":caption:")), None)
    elif language == "toml" and re.fullmatch(r"# \S+\.toml", text.partition("\n")[0]):
        file = text.partition("\n")[0].removeprefix("# ")
    return Block(language, file, text, place)


PAGES = {
    page: found
    for page in ("README.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")))
    if (found := blocks(page))
}


def run_page(page: str, folder: Path) -> None:
    """Run the blocks of a page one after the other in a folder."""
    names: dict[str, object] = {"hitchid": hitchid}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("XDG_CACHE_HOME", str(folder / ".cache"))
        patch.setenv("COLUMNS", str(COLUMNS))
        for each in PAGES[page]:
            run_block(each, names)


def run_block(block: Block, names: dict[str, object]) -> None:
    """Run a block, or write the file it is, and hold it against the program's own reader."""
    if block.file is not None:
        path = Path(block.file)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(block.text, encoding="utf-8")
    match block.language:
        case "python":
            exec(compile(block.text, block.place, "exec"), names)  # noqa: S102
        case "console":
            for command in commands(block):
                run_command(command, block.place)
        case "toml":
            check_toml(block)
        case "json":
            for line in block.text.splitlines():
                json.loads(line)
        case "text":
            pass
        case other:
            pytest.fail(f"{block.place}: a block of a kind that nobody runs: '{other}'")


def commands(block: Block) -> Iterator[Command]:
    """Return the commands of a console, each with what is printed below it."""
    lines = block.text.splitlines()
    starts = [number for number, line in enumerate(lines) if line.startswith("$ ")]
    assert starts[:1] == [0], f"{block.place}: required a first line that begins with '$ '"
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        line, _, said = lines[start].removeprefix("$ ").partition("  # exit code ")
        yield Command(line, int(said or 0), tuple(lines[start + 1 : stop]))


def run_command(command: Command, place: str) -> None:
    """Run one command of the program and compare exit code and what it printed."""
    if command.line.startswith(ELSEWHERE):
        return
    program, *arguments = shlex.split(command.line)
    assert program == "hitchid", f"{place}: a command that nobody runs: '{command.line}'"
    heard = None
    if "<" in arguments:
        at = arguments.index("<")
        heard = Path(arguments[at + 1]).read_text(encoding="utf-8")
        del arguments[at : at + 2]
    code, printed = call(arguments, heard)
    told = f"{place}: $ {command.line}"
    assert code == command.code, f"{told}\nexit code {code}, required {command.code}\n{printed}"
    left = iter(printed.splitlines())
    for line in command.shown:
        found = line in ("", LEFT_OUT) or any(alike(line, each) for each in left)
        assert found, f"{told}\ndid not print: {line}\n{printed}"


def call(arguments: list[str], heard: str | None) -> tuple[int, str]:
    """Return exit code and output of the program; its own errors end it as they do in `hitchid.cli.main`."""
    result = CliRunner().invoke(cli.app, arguments, input=heard)
    error, printed = result.exception, result.output
    if isinstance(error, hitchid.HitchError):
        return 2 if isinstance(error, InputError) else 1, f"{printed}hitchid: {error}\n"
    if error is not None and not isinstance(error, SystemExit):
        raise error
    return result.exit_code, printed


def alike(one: str, other: str) -> bool:
    """Tell whether two lines say the same, frames aside; numbers to a fifth, which depend on the machine."""
    words, numbers = split(one)
    others, theirs = split(other)
    return words == others and numbers == pytest.approx(theirs, rel=0.2, abs=1e-9)


def split(line: str) -> tuple[str, list[float]]:
    """Return a line without its frame, with # for every number, and the numbers."""
    plain = " ".join(re.sub(r"[\u2500-\u257f]", " ", line).split())
    return NUMBER.sub("#", plain), [float(each[0]) for each in NUMBER.finditer(plain)]


def check_toml(block: Block) -> None:
    """Read a TOML block by that reader of the program which it is for."""
    keys = set(tomllib.loads(block.text))
    path = Path(block.file or "unnamed.toml")
    path.write_text(block.text, encoding="utf-8")
    reader = read_campaign_file if keys & ALSO_SET else read_limits if "unit" in keys else read_settings
    reader(path)


def test_there_are_examples_of_every_command():
    shown = {
        command.line.split()[1]
        for found in PAGES.values()
        for each in found
        if each.language == "console"
        for command in commands(each)
        if command.line.startswith("hitchid ")
    }
    known = {command.callback.__name__ for command in cli.app.registered_commands}
    assert shown >= known - {"reproduce"}  # takes minutes; test_sun2025.py runs it


def test_the_examples_work(subtests, tmp_path):
    """The tutorial, then every other page from the folders and the `quick.toml` it leaves.

    One test, so that one worker runs the tutorial once.
    """
    tutorial = tmp_path / "tutorial"
    tutorial.mkdir()
    run_page(TUTORIAL, tutorial)
    assert {"logs", "ramps", "model", "results"} <= set(os.listdir(tutorial))
    quick = partial(identify, **read_settings(tutorial / "quick.toml"))
    for page in sorted(set(PAGES) - {TUTORIAL}):
        with subtests.test(page=page), pytest.MonkeyPatch.context() as patch:
            folder = tmp_path / page.replace("/", "-")
            for name in ("logs", "ramps", "model"):
                shutil.copytree(tutorial / name, folder / name)
            shutil.copy(tutorial / "quick.toml", folder)
            if page == "README.md":
                # It identifies with all there is, which takes minutes, and saves a model where none was.
                patch.setattr(hitchid, "identify", quick, raising=False)
                shutil.rmtree(folder / "model")
            run_page(page, folder)
