"""Stores: every file whole or not at all, local and in a bucket; errors name the store."""

import os
import socket
import threading
import warnings
from pathlib import Path

import pytest

from hitchid.errors import InputError
from hitchid.fleet.store import Store, StoreError, download

BUCKET = "fleet"


@pytest.fixture(scope="module")
def s3():
    """Return the URL of an empty bucket of an S3 server on loopback."""
    boto3 = pytest.importorskip("boto3")
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # moto warns of parts of it that are not installed
        server_module = pytest.importorskip("moto.server")
    server = server_module.ThreadedMotoServer(ip_address="127.0.0.1", port=0)
    server.start()
    host, port = server.get_host_and_port()
    endpoint = f"http://{host}:{port}"
    settings = {
        "AWS_ENDPOINT_URL": endpoint,
        "AWS_ACCESS_KEY_ID": "test",
        "AWS_SECRET_ACCESS_KEY": "test",
        "AWS_DEFAULT_REGION": "us-east-1",
    }
    before = {name: os.environ.get(name) for name in settings}
    os.environ.update(settings)
    pytest.importorskip("s3fs").S3FileSystem.clear_instance_cache()  # of a server before
    boto3.client("s3", endpoint_url=endpoint).create_bucket(Bucket=BUCKET)
    yield f"s3://{BUCKET}"
    server.stop()
    for name, value in before.items():
        os.environ.pop(name) if value is None else os.environ.update({name: value})


@pytest.fixture(params=["local", "memory", pytest.param("s3", marks=pytest.mark.long)])
def store(request, tmp_path):
    """Return an empty store of each kind."""
    if request.param == "s3":
        return Store(f"{request.getfixturevalue('s3')}/{tmp_path.name}")
    return Store(str(tmp_path / "store") if request.param == "local" else f"memory://{tmp_path.name}")


def test_what_is_written_is_read_and_listed(store):
    store.write("models/a/model.json", b"model")
    store.write("rows/a.json", b"row")
    store.write("rows/b.json", b"")
    assert store.read("models/a/model.json") == b"model"
    assert store.read_many(["rows/a.json", "rows/b.json"]) == {"rows/a.json": b"row", "rows/b.json": b""}
    assert store.read_many(["rows/a.json"]) == {"rows/a.json": b"row"}
    assert [(file.name, file.size) for file in store.files()] == [
        ("models/a/model.json", 5),
        ("rows/a.json", 3),
        ("rows/b.json", 0),
    ]
    assert [file.name for file in store.below("rows").files()] == ["a.json", "b.json"]
    assert store.has("rows/a.json")
    assert not store.has("rows/c.json")


@pytest.mark.parametrize("name", ["rig [1]", "rig *", "rig ?", "[a-z]", "**", "rig {1,2}", "ü %20#"])
def test_a_name_like_a_pattern_is_read_as_it_is(store, name):
    others = ("rig 1", "rig 2", "a", "z")
    for other in (*others, name):
        store.write(f"{other}/log.csv", other.encode())
    wanted = [f"{name}/log.csv", "rig 1/log.csv"]
    assert store.read_many(wanted) == {wanted[0]: name.encode(), wanted[1]: b"rig 1"}
    assert store.read_many(wanted[:1]) == {wanted[0]: name.encode()}
    assert {file.name for file in store.files()} == {f"{folder}/log.csv" for folder in (*others, name)}


def test_a_listing_tells_that_a_file_has_changed(store):
    store.write("a.csv", b"1")
    (first,) = store.files()
    store.write("a.csv", b"2")
    if store.is_local:  # within the resolution of its clock
        os.utime(Path(store.url) / "a.csv", (1.0, 1.0))
    (second,) = store.files()
    assert first.version != second.version
    assert second.modified


def test_an_empty_store_has_no_files(store):
    assert store.files() == store.below("rows").files() == ()
    with pytest.raises(StoreError, match=r"rows/a\.json: cannot read"):
        store.read("rows/a.json")


def test_files_are_downloaded_flat(store, tmp_path):
    store.write("tractor/a.csv", b"1")
    store.write("tractor/campaign.toml", b"2")
    folder = tmp_path / "logs"
    folder.mkdir()
    assert download(store, store.files(), folder) == {"a.csv": b"1", "campaign.toml": b"2"}
    assert (folder / "a.csv").read_bytes() == b"1"


def test_what_is_being_written_is_hidden(tmp_path):
    store = Store(str(tmp_path))
    store.write("rows/a.json", b"row")
    (tmp_path / "rows" / ".b.json-unfinished").write_bytes(b"")
    assert [file.name for file in store.files()] == ["rows/a.json"]


@pytest.mark.long
def test_a_server_that_ends_leaves_no_part_of_files(s3, tmp_path, monkeypatch):
    """A proxy in front of the server cuts each connection after some bytes of the content."""
    endpoint = os.environ["AWS_ENDPOINT_URL"]
    proxy = CuttingProxy(int(endpoint.rpartition(":")[2]))
    store = Store(f"{s3}/{tmp_path.name}")
    store.write("model/a", b"before")
    S3FileSystem = pytest.importorskip("s3fs").S3FileSystem
    monkeypatch.setattr(S3FileSystem, "retries", 1)
    try:
        monkeypatch.setenv("AWS_ENDPOINT_URL", f"http://127.0.0.1:{proxy.port}")
        S3FileSystem.clear_instance_cache()
        with pytest.raises(StoreError, match="cannot write"):
            store.write("model/a", b"x" * 3_000_000)
    finally:
        proxy.close()
        monkeypatch.setenv("AWS_ENDPOINT_URL", endpoint)
        S3FileSystem.clear_instance_cache()
    assert proxy.cuts > 0
    assert store.read("model/a") == b"before"


@pytest.mark.parametrize("url", ["nonsense://bucket", "s4://bucket/logs"])
def test_an_unknown_kind_of_store_is_refused(url):
    with pytest.raises(InputError, match=url):
        Store(url).files()


class CuttingProxy:
    """Forwards connections to a port of this machine, and cuts each after a megabyte from the client."""

    LIMIT = 1_000_000  # bytes

    def __init__(self, port: int):
        self._target, self.cuts = port, 0
        self._listener = socket.create_server(("127.0.0.1", 0))
        self.port = self._listener.getsockname()[1]
        threading.Thread(target=self._accept, daemon=True).start()

    def close(self) -> None:
        self._listener.close()

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return
            server = socket.create_connection(("127.0.0.1", self._target))
            threading.Thread(target=self._forward, args=(client, server, self.LIMIT), daemon=True).start()
            threading.Thread(target=self._forward, args=(server, client, 1 << 40), daemon=True).start()

    def _forward(self, source: socket.socket, sink: socket.socket, limit: int) -> None:
        passed = 0
        try:
            while data := source.recv(65536):
                passed += len(data)
                if passed > limit:
                    self.cuts += 1
                    break
                sink.sendall(data)
        except OSError:
            pass
        for end in (source, sink):
            end.close()
