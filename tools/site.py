"""Build the documentation of every released version and of this tree, each in a folder, with a list of them.

python -m tools.site [OUT]   # build/docs by default
"""

import html
import os
import re
import subprocess
import sys
import tempfile
import tomllib
from collections.abc import Sequence
from pathlib import Path

ROOT = Path(__file__).parents[1]
ABOVE = "folder-of-all-versions/"  # in links, until a page is written
LIST = """<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>hitchid: versions of the documentation</title>
<style>body {{ font: 1rem/1.5 system-ui, sans-serif; margin: 3rem auto; max-width: 40rem }}</style>
</head>
<body>
<h1>hitchid</h1>
<p>Documentation by version; the first is the newest.</p>
<ul>
{items}
</ul>
</body>
</html>
"""


def main(out: Path) -> None:
    """Build all versions into a folder; a tree that is past the tag of its version is the next one."""
    own = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["version"]
    tags = [tag for tag in git("tag", "--list", "v*").split() if re.fullmatch(r"v\d+\.\d+\.\d+", tag)]
    is_past = f"v{own}" in tags and f"v{own}" not in git("tag", "--points-at", "HEAD").split()
    released = sorted(
        {own, *(tag[1:] for tag in tags)}, key=lambda v: tuple(map(int, v.split("."))), reverse=True
    )
    versions = [*released, *(["next"] if is_past else [])]
    for version in versions:
        if version == ("next" if is_past else own):
            build(ROOT, out, version, released[0])
            continue
        with tempfile.TemporaryDirectory() as place:
            git("worktree", "add", "--detach", place, f"v{version}")
            try:
                build(Path(place), out, version, released[0])
            finally:
                git("worktree", "remove", "--force", place)
    write_list(out, versions)


def git(*arguments: str) -> str:
    """Return what git prints."""
    command = ["git", "-C", str(ROOT), *arguments]
    return subprocess.run(command, capture_output=True, text=True, check=True).stdout  # noqa: S603


def build(tree: Path, out: Path, version: str, newest: str) -> None:
    """Build the pages of a tree from its own sources; those of another version than the newest say so."""
    command = [sys.executable, "-m", "sphinx", "-W", "--keep-going", "-n", "-q", "-b", "html"]
    command += ["-D", f"version={version}", "-D", f"release={version}", "-D", f"html_title=hitchid {version}"]
    if version != newest:
        link = f'<a href="{ABOVE}{newest}/index.html">{newest}</a>'
        command += ["-D", f"html_theme_options.announcement=Version {version}. The newest release is {link}."]
    paths = [str(tree / "docs"), str(out / version)]
    environment = os.environ | {"PYTHONPATH": str(tree / "src")}
    subprocess.run([*command, *paths], check=True, env=environment)  # noqa: S603
    # The theme has one announcement for all pages; the way up depends on the page.
    for page in (out / version).rglob("*.html"):
        up = "../" * len(page.relative_to(out).parts[:-1])
        page.write_text(page.read_text().replace(ABOVE, up))


def write_list(out: Path, versions: Sequence[str]) -> None:
    """Write the list of versions, newest first."""
    named = [html.escape(version) for version in versions]
    items = "\n".join(f'<li><a href="{version}/index.html">{version}</a></li>' for version in named)
    (out / "index.html").write_text(LIST.format(items=items))


if __name__ == "__main__":
    main(Path(sys.argv[1]) if sys.argv[1:] else ROOT / "build" / "docs")
