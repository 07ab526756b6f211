"""Datasets by Ray: two nodes on this computer, a worker and a node that die, the same bytes as without; and scores."""

from __future__ import annotations

import json
import os
import socket
import time
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from dasim.base import executors
from dasim.base.errors import InputError
from dasim.cli import run
from dasim.dataset import verify
from tests.support.datasets import WALL, log_entries, make_dataset, spec_file, spread, sums
from validation.dataset_scores.entrants import entrants
from validation.dataset_scores.run import score_dataset
from validation.dataset_scores.work import ScoreJob
from validation.dataset_scores.work import work as score

pytest.importorskip("ray", reason="Ray is not installed (extra 'cluster')")
pytestmark = [
    # Ray leaves sockets and files of its own processes open.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning:ray"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning"),
]

SAMPLES = 24
SLACK_S = 10.0  # beyond the ten seconds that an address gets: a busy computer imports Ray in it


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
def test_relative_paths_are_those_of_the_command(cluster, tmp_path, renderer, monkeypatch, capsys):
    """Rationale: a node starts its processes in a folder of its own. Set-up: dataset, depth maps and output by relative
    paths, in a folder that the node did not start in. Expectation: the dataset is where the command was given, with the
    bytes that this process makes, and so are the scores, with the rows of this process.
    """
    nodes, address = cluster
    nodes.add_node(num_cpus=1, include_dashboard=False)
    spec = spec_file(tmp_path, samples=2, more="[splits]\ntest = 1.0")
    (tmp_path / "wall.toml").write_text(WALL.replace("[0, 0, 50]", "[0, 0, 30]"))  # in front of the focus
    monkeypatch.chdir(tmp_path)
    by_ray = ["--executor", "ray", "--address", address]
    assert run(["dataset", "make", "spec.toml", "--out", "set", *by_ray]) == 0
    make_dataset(spec, tmp_path / "local")
    assert sums(tmp_path / "set") == sums(tmp_path / "local")
    (tmp_path / "maps").mkdir()
    for number in range(2):
        np.save(tmp_path / "maps" / f"{number:09d}.npy", np.full((24, 32), 0.3 + 0.1 * number))
    assert run(["dataset", "score", "set", "--method", "theirs=maps", "--out", "scores", *by_ray]) == 0
    assert "leaderboard: scores/leaderboard.html" in capsys.readouterr().out
    results = [json.loads(file.read_text()) for file in (tmp_path / "scores" / "results").glob("*.json")]

    def inline(job, queue):
        while queue:
            yield score(job, queue.popleft())

    rows = score_dataset(ScoreJob("set", "test", "inline", entrants(["theirs=maps"]), None), inline)
    found, expected = ({(row["method"], row["sample"]): row["figures"] for row in some} for some in (results, rows))
    assert found == expected and len(found) == 4
    whole = [found["theirs", f"{number:09d}"]["region"]["all"]["abs-rel"] for number in range(2)]
    np.testing.assert_allclose(whole, [0, 1 / 3], atol=1e-4)


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
