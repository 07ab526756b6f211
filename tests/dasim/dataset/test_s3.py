"""Datasets in an object store: moto's S3 server on this computer, the same bytes as in a folder."""

from __future__ import annotations

import pytest

import dasim
from dasim.base import executors
from dasim.base.errors import InputError
from dasim.cli import run
from dasim.dataset import plan, storage, verify
from tests.support.datasets import make_dataset, spec_file, sums

s3fs = pytest.importorskip("s3fs", reason="s3fs is not installed (extra 'cluster')")
moto_server = pytest.importorskip("moto.server", reason="moto is not installed (extra 'test')")
pytestmark = [
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
    pytest.mark.filterwarnings("ignore::ResourceWarning"),  # connections of s3fs stay open
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
]


@pytest.fixture(scope="module")
def address(renderer):
    """A bucket of a server on this computer, configured by the variables of the AWS tools."""
    server = moto_server.ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AWS_ENDPOINT_URL", f"http://{host}:{port}")
        patch.setenv("AWS_DEFAULT_REGION", "us-east-1")
        for name in ("AWS_ACCESS_KEY_ID", "AWS_SECRET_ACCESS_KEY"):
            patch.setenv(name, "test")
        s3fs.S3FileSystem(skip_instance_cache=True).mkdir("bucket")
        yield "s3://bucket"
    server.stop()


@pytest.mark.parametrize("form", ["webdataset", "folders"])
def test_same_bytes_as_in_a_folder(form, address, tmp_path):
    """Two runs make one half each; no intermediate file remains."""
    spec = spec_file(tmp_path, format=form)
    out = f"{address}/{form}/ds"
    for part in (2, 1):
        make_dataset(spec, out, shard=(part, 2))
    make_dataset(spec, tmp_path / "local")
    assert sums(out) == sums(tmp_path / "local")
    assert list(verify.problems(out)) == []
    assert set(storage.names(out)) == {plan.SUMS, *sums(out)}
    here, there = dasim.open_dataset(tmp_path / "local"), dasim.open_dataset(out)
    assert [s.index for s in there] == [s.index for s in here] == list(range(6))
    assert (there[4].raw_dn == here[4].raw_dn).all()


def test_verify_finds_a_flipped_bit_and_an_extra_file(address, tmp_path):
    out = f"{address}/flipped"
    make_dataset(spec_file(tmp_path), out)
    content = bytearray(storage.read(out, "train-000001.tar"))
    content[len(content) // 2] ^= 1
    storage.write(out, "train-000001.tar", bytes(content))
    storage.write(out, "extra", b"x")
    message = list(verify.problems(out))
    assert "train-000001.tar: its checksum differs" in message and "extra: is not part of the dataset" in message


@pytest.mark.slow
def test_command_by_processes_of_their_own(address, tmp_path, capsys):
    """Each process opens the store for itself."""
    out = f"{address}/command"
    spec = spec_file(tmp_path, samples=2)
    assert run(["dataset", "make", str(spec), "--out", out, "--jobs", "1"]) == 0
    assert run(["dataset", "verify", out]) == 0
    assert "no problems" in capsys.readouterr().out


def test_store_that_refuses_ends_the_run_and_nothing_is_lost(address, tmp_path, monkeypatch):
    """A store that refuses counts as a full disk: no sample fails, and the run can be resumed."""
    spec, out = spec_file(tmp_path), f"{address}/refused"
    write, count = storage.write, [0]

    def refusing(where, name, data):
        if name.startswith("parts/"):
            count[0] += 1
            if count[0] == 4:
                raise ConnectionError("Could not connect to the endpoint")
        write(where, name, data)

    monkeypatch.setattr(storage, "write", refusing)
    with pytest.raises(InputError, match=r"cannot be written: ConnectionError: .* finished samples are stored"):
        make_dataset(spec, out)
    assert storage.names(out, "failed") == [] and "parts/000000002.tar" in storage.names(out)
    make_dataset(spec, out)
    assert count[0] == 4 + 3  # three were there
    assert list(verify.problems(out)) == []


def test_bucket_that_is_not_there(address, tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(executors, "local", lambda *_, **options: None)
    assert run(["dataset", "make", str(spec_file(tmp_path)), "--out", "s3://nowhere/ds"]) == 2
    message = capsys.readouterr().err
    assert "s3://nowhere/ds: cannot be written" in message and len(message.splitlines()) == 1
    assert run(["dataset", "info", f"{address}/nothing"]) == 2
    assert "is not a dataset" in capsys.readouterr().err


def test_store_that_does_not_answer(address, tmp_path, capsys, monkeypatch):
    """Expectation: a message of one line, after the library's own attempts."""
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    storage._file_system_of_process.cache_clear()
    monkeypatch.setattr(s3fs.S3FileSystem, "_cache", {})
    assert run(["dataset", "make", str(spec_file(tmp_path)), "--out", "s3://bucket/silent"]) == 2
    message = capsys.readouterr().err
    assert "Could not connect" in message and len(message.splitlines()) == 1
    storage._file_system_of_process.cache_clear()
