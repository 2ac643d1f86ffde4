"""The built documentation: links have targets, nothing is loaded from outside."""

import importlib.util
import subprocess
import sys
from html.parser import HTMLParser
from itertools import pairwise
from pathlib import Path
from urllib.parse import unquote, urlsplit

import pytest

DOCS = Path(__file__).parents[2] / "docs"
NEEDED = ("sphinx", "furo", "myst_parser", "latex2mathml")
MISSING = [name for name in NEEDED if importlib.util.find_spec(name) is None]
LOADING = {"img": ("src", "srcset"), "script": ("src",), "iframe": ("src",), "link": ("href",)}
LOADING |= dict.fromkeys(("audio", "video", "source", "embed"), ("src", "poster"))

pytestmark = [
    pytest.mark.long,
    pytest.mark.skipif(bool(MISSING), reason=f"not installed: {', '.join(MISSING)}; run make setup"),
]


class Page(HTMLParser):
    """Content of a page: headings, targets, links, loaded files, pictures, equations."""

    def __init__(self, path: Path) -> None:
        """Read a page."""
        super().__init__()
        self.text = path.read_text(encoding="utf-8")
        self.headings: list[int] = []
        self.targets: set[str] = set()
        self.links: list[str] = []
        self.loaded: list[str] = []
        self.alternatives: list[str | None] = []
        self.equations = 0
        self.feed(self.text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        """Record one element."""
        given = dict(attrs)
        self.targets |= {value for name, value in attrs if name in ("id", "name") and value}
        self.equations += tag == "math"
        if tag in ("h1", "h2", "h3", "h4", "h5", "h6"):
            self.headings.append(int(tag[1]))
        if tag == "a" and given.get("href"):
            self.links.append(given["href"])
        if tag == "img":
            self.alternatives.append(given.get("alt"))
        # An address that is only given, such as that of the page itself, is not loaded.
        if tag != "link" or given.get("rel") not in ("canonical", "next", "prev", "index", "search"):
            self.loaded += [given[name] for name in LOADING.get(tag, ()) if given.get(name)]
        if given.get("style"):
            self.loaded += addresses(given["style"])


def addresses(style: str) -> list[str]:
    """Return what `url(…)` and `@import "…"` of a style name."""
    named = [rest.partition(")")[0].strip("'\" ") for rest in style.split("url(")[1:]]
    return named + [rest.split(";")[0].strip("'\" ") for rest in style.split("@import")[1:]]


def outside(address: str) -> bool:
    """Return whether an address leads to another machine; `data:` contains its content."""
    parts = urlsplit(address)
    return bool(parts.netloc) or parts.scheme not in ("", "data")


@pytest.fixture(scope="module")
def site(once):
    """Return the folder of the built site; a warning is an error."""

    def build(folder):
        options = ["-W", "--keep-going", "-n", "-q", "-b", "html", "-d"]
        command = [sys.executable, "-m", "sphinx", *options, folder / "doctrees", DOCS, folder / "html"]
        done = subprocess.run(list(map(str, command)), capture_output=True, text=True)  # noqa: S603
        assert done.returncode == 0, done.stderr

    return once("site", build) / "html"


@pytest.fixture(scope="module")
def pages(site):
    """Return every page by its path."""
    return {path: Page(path) for path in sorted(site.rglob("*.html"))}


def test_every_page_of_the_source_is_built_and_in_the_contents(pages, site):
    sources = {path.relative_to(DOCS).with_suffix("") for path in DOCS.rglob("*.md")}
    assert {path.relative_to(site).with_suffix("") for path in pages} >= sources
    contents = {urlsplit(link).path for link in pages[site / "index.html"].links}
    above = {path for path in sources if path.parent != Path("reference") or path.name == "index"}
    assert contents >= {f"{path.as_posix()}.html" for path in above - {Path("index")}}


def test_every_link_leads_somewhere_outside_by_https(pages, site):
    broken = []
    for path, page in pages.items():
        for link in page.links:
            parts = urlsplit(link)
            if parts.scheme or parts.netloc:
                assert parts.scheme == "https", link
                continue
            goal = (path.parent / unquote(parts.path)).resolve() if parts.path else path
            fragment = unquote(parts.fragment)
            is_there = goal in pages if goal.suffix == ".html" else goal.is_file()
            if not is_there or (fragment and goal in pages and fragment not in pages[goal].targets):
                broken.append(f"{path.relative_to(site)}: {link}")
    assert not broken


def test_what_is_loaded_is_there_and_not_outside(pages, site):
    loaded = [(path, address) for path, page in pages.items() for address in page.loaded]
    assert len(loaded) > len(pages)
    for path, address in loaded:
        file = path.parent / unquote(urlsplit(address).path)
        assert address.startswith("data:") or file.resolve().is_file(), (path, address)
    for path in site.rglob("*.css"):
        loaded += [(path, address) for address in addresses(path.read_text(encoding="utf-8"))]
    assert not [(str(path.relative_to(site)), address) for path, address in loaded if outside(address)]


def test_every_picture_has_alternative_text(pages):
    texts = [(path, text) for path, page in pages.items() for text in page.alternatives]
    assert texts
    assert [(path, text) for path, text in texts if len((text or "").split()) <= 3] == []


def test_equations_are_mathml(pages, site):
    method = pages[site / "method.html"]
    assert method.equations > 10
    assert 'class="eqno"' in method.text
    for path, page in pages.items():
        assert not [address for address in page.loaded if "mathjax" in address.lower()], path
        assert "$$" not in page.text, path


def test_the_help_of_every_command_is_shown(pages, site):
    from hitchid.cli import app

    text = pages[site / "reference" / "command-line.html"].text
    groups = {"": app} | {
        f"{group.name or group.typer_instance.info.name} ": group.typer_instance
        for group in app.registered_groups
    }
    for prefix, group in groups.items():
        for command in group.registered_commands:
            name = f"{prefix}{command.callback.__name__}"
            assert f"Usage: hitchid {name} " in text
            assert f"Example: hitchid {name} " in text or "|" in command.epilog


def test_search_needs_no_network(site, browser):
    page = browser.new_page()
    requests: list[str] = []
    page.on("request", lambda request: requests.append(request.url))
    page.goto(f"{(site / 'search.html').as_uri()}?q=dead+zone")
    result = page.locator("#search-results").get_by_role("link", name="The method", exact=True)
    result.wait_for(timeout=60_000)  # ms; however busy the machine is
    page.close()
    assert [url for url in requests if not url.startswith("file:")] == []


def test_every_page_has_one_title_and_skips_no_rank(pages, site):
    for path, page in pages.items():
        name = path.relative_to(site)
        assert page.headings.count(1) == 1, name
        ranks = page.headings[page.headings.index(1) :]
        assert all(after - before <= 1 for before, after in pairwise(ranks)), name
