"""A release: two builds are equal, the wheel holds the package alone, and README's example runs from it."""

import re
import subprocess
import tomllib
from datetime import UTC, datetime
from pathlib import Path
from zipfile import ZipFile

import pytest
from tools import release, site

ROOT = Path(__file__).parents[1]
DATE = datetime(2026, 1, 2, tzinfo=UTC)
VERSION = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
DATA = {
    "hitchid/py.typed",
    "hitchid/report/templates/page.html",
    "hitchid/report/templates/page.css",
    "hitchid/report/templates/report.typ",
    "hitchid/bench/parameters/nominal.toml",
}


@pytest.fixture(scope="module")
def built(tmp_path_factory):
    """Return sdist and wheel."""
    return release.build(ROOT, tmp_path_factory.mktemp("first") / "a", DATE)


@pytest.mark.long
def test_two_builds_in_two_folders_are_equal(built, tmp_path):
    other = release.build(ROOT, tmp_path / "another place", DATE)
    release.check_same(built, other)
    later = release.build(ROOT, tmp_path / "later", DATE.replace(year=2027))
    with pytest.raises(release.ReleaseError, match="of two builds differ"):
        release.check_same(built, later)


@pytest.mark.long
def test_the_wheel_holds_the_package_and_nothing_else(built):
    sdist, wheel = built
    names = set(ZipFile(wheel).namelist())
    packaged = {name for name in names if ".dist-info/" not in name}
    sources = {
        path.relative_to(ROOT / "src").as_posix()
        for path in (ROOT / "src").rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert packaged == sources
    assert packaged >= DATA
    metadata = {name.partition(".dist-info/")[2] for name in names - packaged}
    assert metadata == {"METADATA", "WHEEL", "RECORD", "entry_points.txt", "licenses/LICENSE"}
    release.check_metadata(wheel, VERSION)
    assert sdist.name == f"hitchid-{VERSION}.tar.gz"


@pytest.mark.long
@pytest.mark.parametrize("age", ["oldest", "newest"])
def test_readmes_example_runs_in_a_fresh_environment(built, age, tmp_path):
    pythons = list(release.pythons().values())
    if len(pythons) < 2:
        pytest.skip(f"needs two of Python {', '.join(release.VERSIONS)}; found {len(pythons)}")
    python = pythons[0 if age == "oldest" else -1]
    asked = [python, "-m", "pip", "--retries", "0", "--timeout", "10", "download", "--no-deps", "typer"]
    done = subprocess.run([*asked, "--dest", tmp_path / "asked"], capture_output=True, check=False)  # noqa: S603
    if done.returncode:
        pytest.skip("pip reaches no index of packages")
    program = release.try_out(built[1], python, tmp_path, pinned=True)
    (package,) = program.parents[1].glob("lib/python*/site-packages/hitchid")
    release.run([program, "-W", "error", "-m", "compileall", "-q", "-f", package], tmp_path)


@pytest.mark.parametrize(
    ("changelog", "problem"),
    [
        ("## [Unreleased]\n\n- new\n\n## [0.3.0] - 2026-01-01\n", "expected nothing unreleased, got '- new'"),
        ("## [Unreleased]\n\n## [0.2.0] - 2026-01-01\n", r"expected '## \[0\.3\.0\] - YYYY-MM-DD'"),
        ("## [Unreleased]\n\n## [0.3.0] - 2026-13-45\n", "expected a day for 0.3.0, got '2026-13-45'"),
        ("## Unreleased\n\n* new\n\n## [0.3.0] - 2026-01-01\n", r"nothing unreleased, got '\* new'"),
        ("## [Unreleased]\n", r"expected '## \[0\.3\.0\] - YYYY-MM-DD'"),
    ],
)
def test_a_release_needs_its_day_and_nothing_unreleased(tmp_path, changelog, problem):
    (tmp_path / "pyproject.toml").write_text('[project]\nversion = "0.3.0"\n')
    (tmp_path / "CHANGELOG.md").write_text(f"# Changelog\n\n{changelog}")
    with pytest.raises(release.ReleaseError, match=problem):
        release.stated_version(tmp_path)
    (tmp_path / "CHANGELOG.md").write_text("## [Unreleased]\n\n## [0.3.0] - 2026-01-02\n")
    assert release.stated_version(tmp_path) == ("0.3.0", DATE)


def test_hashes_are_those_that_sha256sum_checks(tmp_path):
    (tmp_path / "b.txt").write_text("b")
    (tmp_path / "a.txt").write_text("a")
    text = release.write_hashes(tmp_path).read_text()
    subprocess.run(["sha256sum", "-c", "--quiet"], input=text, text=True, cwd=tmp_path, check=True)  # noqa: S607
    assert [line.split()[1] for line in text.splitlines()] == ["a.txt", "b.txt"]


def test_versions_of_the_pages_are_listed_from_the_newest_on(tmp_path, monkeypatch):
    built = []
    monkeypatch.setattr(site, "build", lambda tree, out, version, newest: built.append((version, newest)))
    tags = {"--list": "v0.1.9\nv0.1.10\nvnext\n", "--points-at": ""}
    monkeypatch.setattr(site, "git", lambda *said: tags.get(said[1], "") if said[0] == "tag" else "")
    site.main(tmp_path)
    assert built == [(VERSION, VERSION), ("0.1.10", VERSION), ("0.1.9", VERSION)]
    listed = re.findall(r'<a href="(\S+)/index\.html">', (tmp_path / "index.html").read_text())
    assert listed == [VERSION, "0.1.10", "0.1.9"]
    # After the release of this version the tree is another one.
    built.clear()
    tags["--list"] += f"v{VERSION}\n"
    site.main(tmp_path)
    assert built == [(VERSION, VERSION), ("0.1.10", VERSION), ("0.1.9", VERSION), ("next", VERSION)]


def test_a_file_that_is_too_large_is_no_release(built, monkeypatch):
    monkeypatch.setattr(release, "MAX_BYTES", 1000)
    with pytest.raises(release.ReleaseError, match="expected at most 1000"):
        release.check_metadata(built[1], VERSION)
