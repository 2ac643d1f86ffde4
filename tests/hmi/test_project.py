"""Names from an operator never leave the project folder, and its content is told as it is."""

import os
import resource

import pytest
from hypothesis import given
from hypothesis import strategies as st

from hitchid.errors import InputError, OutputError
from hitchid.hmi import project
from hitchid.hmi.project import FOLDERS, checked_name, contents, inside, logs, write_new


@pytest.fixture
def root(tmp_path):
    """Return a project beside a file that is nobody's business."""
    (tmp_path / "secret.csv").write_text("secret")
    root = tmp_path / "project"
    for folder in FOLDERS:
        (root / folder).mkdir(parents=True)
    (root / "hmi.log").write_text("log")
    (root / "uploads" / "a.csv").write_text("a")
    return root


def test_a_link_to_the_project_leads_to_its_files(root, tmp_path):
    (tmp_path / "link").symlink_to(root)
    for project_folder in (root, tmp_path / "link"):
        assert inside(project_folder, "uploads/a.csv").read_text() == "a"


@pytest.mark.parametrize(
    "path",
    [
        "uploads/../../secret.csv",
        "../secret.csv",
        "uploads/..",
        "uploads/.",
        "uploads/",
        "uploads",
        "uploads//a.csv",
        "/uploads/a.csv",
        "./uploads/a.csv",
        "uploads/a.csv/",
        "uploads\\a.csv",
        "uploads/a.csv\0",
        "uploads/a.csv\n",
        "uploads/%2e%2e/secret.csv",
        "uploads/..%2f..%2fsecret.csv",
        "uploads/\uff0e\uff0e/secret.csv",
        "hmi.log",
        "UPLOADS/a.csv",
        "uploads/none.csv",
        "uploads/-rf",
        "--out/a.csv",
        "/etc/passwd",
        "",
        None,
        3,
        ["uploads", "a.csv"],
        b"uploads/a.csv",
    ],
)
def test_any_other_path_is_refused(root, path):
    with pytest.raises(InputError, match=r"^path: "):
        inside(root, path)


@pytest.mark.parametrize("target", ["../../secret.csv", "/etc/passwd", "../.."])
def test_a_link_that_leads_out_is_refused_and_shows_nothing(root, target):
    (root / "uploads" / "link").symlink_to(target)
    (root / "campaigns" / "out").symlink_to(target)
    (root / "models" / "broken").symlink_to("nowhere")
    for path in ("uploads/link", "uploads/link/secret.csv"):
        with pytest.raises(InputError, match="there is no"):
            inside(root, path)
    content = contents(root)
    assert content["campaigns"] == content["models"] == []
    assert [entry["name"] for entry in content["uploads"]] == ["a.csv"]


@given(st.text(alphabet="a./\\%2e-~\0 :é", max_size=20), st.sampled_from(["", *FOLDERS]))
def test_whatever_is_asked_for_nothing_outside_is_found(tmp_path_factory, text, folder):
    root = tmp_path_factory.getbasetemp() / "found"
    (root / "uploads").mkdir(parents=True, exist_ok=True)
    try:
        path = inside(root, f"{folder}/{text}")
    except InputError:
        return
    assert os.path.realpath(path).startswith(f"{os.path.realpath(root)}/{folder}/")


@pytest.mark.parametrize(
    "name", ["", ".", "..", "a..b", ".a", "-a", "a/b", "a b", "a\n", "a\0", "é", 61 * "a", None, 3, ["a"]]
)
def test_a_name_that_is_none_is_refused(name):
    with pytest.raises(InputError, match=r"^name: expected at most 60 letters"):
        checked_name(name)
    for other in ("a", "lifting-01.csv", "2026_05.toml", 60 * "a"):
        assert checked_name(other) == other


def test_the_content_of_a_project_is_listed_newest_first(root):
    files = {
        "campaigns/old": ("campaign.toml", "lifting-0.csv"),
        "campaigns/new": ("campaign.toml", "lifting-0.csv", "lifting-1.csv"),
        "models/a": ("model.json",),
        "models/half": ("other",),
        "reports/r": ("report.html",),
        "controllers/c-report": ("report.html",),
        "controllers": ("c.toml",),
        "drives": (".hidden",),
    }
    for folder, names in files.items():
        (root / folder).mkdir(exist_ok=True)
        for name in names:
            (root / folder / name).touch()
    for number, name in enumerate(["old", "new"]):
        os.utime(root / "campaigns" / name, (1e9 + number, 1e9 + number))
    content = contents(root)
    assert content["folder"] == "project"
    assert [(entry["name"], entry["logs"]) for entry in content["campaigns"]] == [("new", 2), ("old", 1)]
    assert content["campaigns"][1]["changed"] == "2001-09-09T01:46:40+00:00"
    assert [entry["path"] for entry in content["models"]] == ["models/a"]
    assert [entry["report"] for entry in content["reports"]] == [
        "/files/reports/r/report.html",
        "/files/controllers/c-report/report.html",
    ]
    assert [entry["name"] for entry in content["controllers"]] == ["c.toml"]
    assert content["drives"] == content["recordings"] == []
    assert all(contents(root / "models")[folder] == [] for folder in FOLDERS)  # an empty folder is a project


def test_of_many_files_the_newest_are_listed(root, monkeypatch):
    monkeypatch.setattr(project, "MOST_ENTRIES", 3)
    for number in range(5):
        path = root / "recordings" / f"{number}.csv"
        path.touch()
        os.utime(path, (1e9 + number, 1e9 + number))
    content = contents(root)
    assert [entry["name"] for entry in content["recordings"]] == ["4.csv", "3.csv", "2.csv"]
    assert content["most"] == 3
    assert logs(root) == [f"recordings/{number}.csv" for number in (4, 3, 2, 1, 0)]


def test_what_is_new_is_whole_or_not_there(root, monkeypatch):
    write_new(root, "campaigns/monday/campaign.toml", b"a")
    assert (root / "campaigns" / "monday" / "campaign.toml").read_bytes() == b"a"
    with pytest.raises(OutputError, match="exists already; choose another name"):
        write_new(root, "campaigns/monday/campaign.toml", b"b")
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard))  # a disk that is full
    try:
        with pytest.raises(OutputError, match=r"uploads/b\.csv: cannot be written: File too large"):
            write_new(root, "uploads/b.csv", bytes(2000))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not (root / "uploads" / "b.csv").exists()
