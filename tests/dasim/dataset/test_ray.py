"""Datasets by Ray: two nodes on this computer, a worker and a node that die, the same bytes as without."""

from __future__ import annotations

import os
import socket
import time
from collections import Counter
from pathlib import Path

import pytest

from dasim.base import executors
from dasim.base.errors import InputError
from dasim.dataset import verify
from tests.support.datasets import log_entries, make_dataset, spec_file, spread, sums

pytest.importorskip("ray", reason="Ray is not installed (extra 'cluster')")
pytestmark = [
    # Ray leaves sockets and files of its own processes open.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning:ray"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

SAMPLES = 24
SLACK_S = 2.0  # beyond the ten seconds that an address gets


@pytest.fixture
def cluster(monkeypatch):
    """A head without processors, and two removable nodes with one processor each."""
    from ray.cluster_utils import Cluster

    before = os.environ.get("PYTHONPATH")
    path = os.pathsep.join([str(Path(__file__).parents[3]), *([before] if before else [])])
    monkeypatch.setenv("PYTHONPATH", path)  # of the workers
    monkeypatch.setenv("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    monkeypatch.setenv("RAY_USAGE_STATS_ENABLED", "0")
    monkeypatch.setenv("GRPC_ENABLE_FORK_SUPPORT", "false")  # else its client server may crash in a fork
    port = free_port()
    head = {"num_cpus": 0, "include_dashboard": False, "ray_client_server_port": port}
    nodes = Cluster(initialize_head=True, head_node_args=head)
    yield nodes, f"ray://127.0.0.1:{port}"
    import ray

    ray.shutdown()
    nodes.shutdown()


def free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


@pytest.mark.slow
def test_worker_and_node_die_in_the_middle(cluster, tmp_path, renderer):
    """The process of one sample dies, then the node of another leaves: no sample is lost, and none is made twice."""
    nodes, address = cluster
    staying, leaving = (nodes.add_node(num_cpus=1, include_dashboard=False) for _ in range(2))
    spec = spec_file(tmp_path, samples=SAMPLES, samples_per_shard=5)
    out = tmp_path / "ray"
    (tmp_path / "nodes").mkdir()
    removed = []

    def watch(progress):
        if progress.done >= SAMPLES // 3 and not removed:
            removed.append(progress.done)
            nodes.remove_node(leaving, allow_graceful=False)

    done = make_dataset(spec, out, executors.ray(address, spread), show=watch)
    assert removed and (tmp_path / "killed").exists()
    assert {path.name for path in (tmp_path / "nodes").iterdir()} == {staying.node_id, leaving.node_id}
    assert done.failed == {} and Counter(log_entries(out)) == {(index, True): 1 for index in range(SAMPLES)}
    assert list(verify.problems(str(out))) == []
    make_dataset(spec, tmp_path / "local")
    assert sums(out) == sums(tmp_path / "local")


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["closed", "silent", "variable", "no address", "nobody"])
def test_address_that_does_not_answer(kind, monkeypatch):
    """Expectation: within ten seconds, a message of one line that says what to do."""
    monkeypatch.delenv("RAY_ADDRESS", raising=False)
    port = free_port()
    address = f"ray://127.0.0.1:{port}"
    with socket.socket() as listener:
        if kind == "silent":
            listener.bind(("127.0.0.1", port))
            listener.listen()
        if kind == "variable":
            monkeypatch.setenv("RAY_ADDRESS", address)
        address = {"variable": "auto", "nobody": "auto", "no address": "127.0.0.1"}.get(kind, address)
        begin = time.monotonic()
        with pytest.raises(InputError) as refused:
            executors.ray(address, spread)
    assert time.monotonic() - begin < executors.RAY_ANSWER_S + SLACK_S
    message = str(refused.value)
    assert "--address" in message and "\n" not in message
    assert ("of the form ray://host:port" if kind == "no address" else "not answer") in message
