"""Every example of README.md and docs/ is run as written, page by page."""

import json
import os
import re
import shlex
import shutil
import subprocess
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
from hitchid.control.drive_report import read_drive_limits
from hitchid.errors import InputError
from hitchid.export.matlab import OPTIONS, find_octave
from hitchid.identification import identify, read_settings
from hitchid.logs.signal_map import read_campaign_file
from hitchid.validation import read_limits

pytestmark = pytest.mark.long

ROOT = Path(__file__).parents[2]
TUTORIAL = "docs/tutorial.md"
# Pages that identify with the default settings, which takes minutes, and save a model where none was.
DEFAULT_SETTINGS = ("README.md", "docs/index.md")
# Commands that are not run here.
NOT_RUN = ("pip install ", "make ", "recorder | ", "mkdir ", "hitchid hmi ")
DIRECTIVES = ("{toctree}", "{figure}", "{glossary}", "{include}", "{eval-rst}", "{command-line}")
CAMPAIGN_KEYS = {"can", "end_stops", "signals", "split", "tests"}
OMITTED = "…"
NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e-?\d+)?")
COLUMNS = 120


class Block(NamedTuple):
    """A fenced block: its language, the file it is written to if any, its text and its place."""

    language: str
    file: str | None
    text: str
    place: str


class Command(NamedTuple):
    """A command of a console: its line, the stated exit code, and the output below it."""

    line: str
    code: int
    shown: tuple[str, ...]


def blocks(page: str) -> list[Block]:
    """Return the fenced blocks of a page that are not directives."""
    fenced = []
    text = (ROOT / page).read_text(encoding="utf-8")
    for token in MarkdownIt("commonmark").parse(text):
        place = f"{page}:{token.map[0] + 1}" if token.map else page
        assert token.type != "code_block" or page == "README.md", f"{place}: not fenced, so it is not run"
        if token.type == "fence" and not token.info.startswith(DIRECTIVES):
            fenced.append(block(token.info, token.content, place))
    return fenced


def block(info: str, text: str, place: str) -> Block:
    """Return one block; its file is given by `:caption:`, or in TOML by a comment on the first line."""
    language, file = info.removeprefix("{code-block}").strip(), None
    if info.startswith("{code-block}"):
        options = list(takewhile(lambda line: line.startswith(":"), text.splitlines(keepends=True)))
        text = text[sum(map(len, options)) :].lstrip("\n")
        file = next((o.removeprefix(":caption:").strip() for o in options if o.startswith(":caption:")), None)
    elif language == "toml" and (named := re.match(r"# (\S+\.toml)\n", text)):
        file = named[1]
    return Block(language, file, text, place)


PAGES = {
    page: page_blocks
    for page in ("README.md", *sorted(str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")))
    if (page_blocks := blocks(page))
}


def run_page(page: str, folder: Path) -> None:
    """Run the blocks of a page one after the other in a folder."""
    names: dict[str, object] = {"hitchid": hitchid}
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("XDG_CACHE_HOME", str(folder / ".cache"))
        patch.setenv("COLUMNS", str(COLUMNS))
        for page_block in PAGES[page]:
            run_block(page_block, names)


def run_block(block: Block, names: dict[str, object]) -> None:
    """Run a block, or write it to its file and read it by the program."""
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
        case "octave":
            run_octave(block)
        case "text" | "c":
            pass
        case other:
            pytest.fail(f"{block.place}: a block of a kind that is not run: '{other}'")


def commands(block: Block) -> Iterator[Command]:
    """Return the commands of a console, each with the output below it."""
    lines = block.text.splitlines()
    starts = [number for number, line in enumerate(lines) if line.startswith("$ ")]
    assert starts[:1] == [0], f"{block.place}: expected a first line that begins with '$ '"
    for start, stop in zip(starts, [*starts[1:], len(lines)], strict=True):
        line, _, code = lines[start].removeprefix("$ ").partition("  # exit code ")
        yield Command(line, int(code or 0), tuple(lines[start + 1 : stop]))


def run_command(command: Command, place: str) -> None:
    """Run a command of the program, the C compiler or what it made, and compare exit code and output."""
    if command.line.startswith(NOT_RUN):
        return
    program, *arguments = shlex.split(command.line)
    if program == "cc" or program.startswith("./"):
        if shutil.which("cc") is None:
            return
        done = subprocess.run([program, *arguments], capture_output=True, text=True, check=False)  # noqa: S603
        code, printed = done.returncode, done.stdout + done.stderr
    else:
        assert program == "hitchid", f"{place}: a command that is not run: '{command.line}'"
        standard_input = None
        if "<" in arguments:
            index = arguments.index("<")
            standard_input = Path(arguments[index + 1]).read_text(encoding="utf-8")
            del arguments[index : index + 2]
        code, printed = call(arguments, standard_input)
    context = f"{place}: $ {command.line}"
    assert code == command.code, f"{context}\nexit code {code}, expected {command.code}\n{printed}"
    remaining = iter(printed.splitlines())
    for line in command.shown:
        matched = line in ("", OMITTED) or any(alike(line, printed_line) for printed_line in remaining)
        assert matched, f"{context}\ndid not print: {line}\n{printed}"


def run_octave(block: Block) -> None:
    """Run lines of Octave, where it is installed; a warning is a failure."""
    octave = find_octave()
    if octave is None:
        return
    Path("block.m").write_text(block.text, encoding="utf-8")
    done = subprocess.run([octave.program, *OPTIONS, "block.m"], capture_output=True, text=True, check=False)  # noqa: S603
    assert (done.returncode, done.stderr) == (0, ""), f"{block.place}\n{done.stderr}"


def call(arguments: list[str], standard_input: str | None) -> tuple[int, str]:
    """Return exit code and output of the program; its own errors end it as they do in `hitchid.cli.main`."""
    result = CliRunner().invoke(cli.app, arguments, input=standard_input)
    error, printed = result.exception, result.output
    if isinstance(error, hitchid.HitchError):
        return 2 if isinstance(error, InputError) else 1, f"{printed}hitchid: {error}\n"
    if error is not None and not isinstance(error, SystemExit):
        raise error
    return result.exit_code, printed


def alike(one: str, other: str) -> bool:
    """Return whether two lines are equal without frames; numbers to 20 %: they depend on the machine."""
    plain = [" ".join(re.sub(r"[\u2500-\u257f]", " ", line).split()) for line in (one, other)]
    words, others = (NUMBER.sub("#", line) for line in plain)
    numbers, theirs = (list(map(float, NUMBER.findall(line))) for line in plain)
    return words == others and numbers == pytest.approx(theirs, rel=0.2, abs=1e-9)


def check_toml(block: Block) -> None:
    """Read a TOML block by the program."""
    keys = set(tomllib.loads(block.text))
    path = Path(block.file or "unnamed.toml")
    path.write_text(block.text, encoding="utf-8")
    readers = {"unit": read_limits, "steps": read_drive_limits}
    own = next((reader for key, reader in readers.items() if key in keys), read_settings)
    (read_campaign_file if keys & CAMPAIGN_KEYS else own)(path)


def test_there_are_examples_of_every_command():
    shown = {
        command.line.split()[1]
        for page_blocks in PAGES.values()
        for page_block in page_blocks
        if page_block.language == "console"
        for command in commands(page_block)
        if command.line.startswith("hitchid ")
    }
    names = {command.callback.__name__ for command in cli.app.registered_commands}
    assert shown >= names - {"reproduce"}  # takes minutes; test_sun2025.py runs it


@pytest.fixture(scope="session")
def tutorial(once):
    """Return the folder in which the tutorial was run."""

    def follow(folder: Path) -> None:
        run_page(TUTORIAL, folder)
        assert {"logs", "ramps", "model", "results"} <= set(os.listdir(folder))

    return once("tutorial", follow)


@pytest.mark.parametrize("page", sorted(set(PAGES) - {TUTORIAL}))
def test_the_examples_work(page, tutorial, tmp_path, monkeypatch):
    """Every page works from the folders and the `quick.toml` that the tutorial leaves."""
    for name in ("logs", "ramps", "model"):
        shutil.copytree(tutorial / name, tmp_path / name)
    shutil.copy(tutorial / "quick.toml", tmp_path)
    if page in DEFAULT_SETTINGS:
        quick = partial(identify, **read_settings(tutorial / "quick.toml"))
        monkeypatch.setattr(hitchid, "identify", quick, raising=False)
        shutil.rmtree(tmp_path / "model")
    run_page(page, tmp_path)
