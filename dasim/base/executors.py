"""Executors: one function for many indices, in processes of this computer or on many computers by Ray.

An executor takes indices from a queue until it is empty, and yields an outcome for each. While it runs, the caller may
append an index to the queue again, to repeat its work.

Tested in tests/dasim/base/test_executors.py, tests/dasim/dataset/test_make.py and tests/dasim/dataset/test_ray.py.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import signal
import socket
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from dasim.base.errors import InputError, describe_error

RAY_ANSWER_S = 10.0
RAY_TRIES = 3
RAY_ERROR_LENGTH = 300  # characters of a message of Ray that are shown
STOP_S = 5.0  # time that a process has to end before it is killed
POLL_S = 0.5
# Processes that share a graphics card by default: a capture keeps the card busy for 2 % of its time, and the host for
# the rest (docs/start.md). Each is planned to take 1 GB of the card and its context.
PER_CARD = 4
ONE_THREAD = {  # for linear algebra: sums over several threads may differ in their last bits
    name: "1" for name in ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "OMP_NUM_THREADS", "NUMBA_NUM_THREADS")
}


@dataclass(frozen=True)
class Outcome:
    """Result of the work on one index."""

    index: int
    error: str | None = None  # one line; None after success
    fatal: bool = False  # every other index would fail for the same reason
    final: bool = False  # a retry is useless: it would fail in the same way, or the executor has retried already
    seconds: float = 0.0
    render_s: float = 0.0  # of ``seconds``, in the renderer
    peak_mb: float = 0.0  # peak memory of the process since its start
    row: dict[str, Any] | None = None


Work = Callable[[Any, int], Outcome]
"""Function of a job and an index. The job must be picklable; an error is returned as an outcome, not raised."""

Executor = Callable[[Any, "deque[int]"], Generator[Outcome]]
"""Generator of the outcomes of all indices of a queue, for a job."""


# --- processes of this computer ------------------------------------------------------------------


@dataclass(frozen=True)
class _Worker:
    process: BaseProcess
    connection: Connection
    place: int  # slot from 0 to the number of workers - 1; it selects the GPU, and a replacement process inherits it


def local(processes: int, work: Work, *, gpu: bool = False) -> Executor:
    """Executor that runs processes of this computer; a process that dies is replaced, and only its own index fails.

    Args:
        processes: number of processes.
        work: function of a job and an index.
        gpu: whether each process uses a graphics card; the cards are assigned in turn.
    """

    def run(job: Any, queue: deque[int]) -> Generator[Outcome]:
        busy: dict[Connection, tuple[_Worker, int]] = {}
        idle: list[_Worker] = []
        places = list(range(processes))
        try:
            while queue or busy:
                while queue and len(busy) < processes:
                    worker = idle.pop() if idle else _start(job, places.pop(), work, gpu)
                    index = queue.popleft()
                    with contextlib.suppress(OSError):  # it died while idle, and its connection is ready below
                        worker.connection.send(index)
                    busy[worker.connection] = (worker, index)
                for ready in wait(list(busy), timeout=POLL_S):
                    assert isinstance(ready, Connection)
                    worker, index = busy.pop(ready)
                    try:
                        outcome = ready.recv()
                        idle.append(worker)
                    except (EOFError, OSError):
                        worker.process.join(STOP_S)
                        places.append(worker.place)
                        ready.close()
                        outcome = Outcome(index, f"its process died ({_exit_reason(worker.process.exitcode)})")
                    yield outcome
        finally:
            _stop([worker for worker, _ in busy.values()] + idle)

    return run


def _start(job: Any, place: int, work: Work, gpu: bool) -> _Worker:
    """Start a process that serves one connection, with one thread of linear algebra and its own graphics card."""
    context = multiprocessing.get_context("spawn")
    local, remote = context.Pipe()
    process = context.Process(target=_serve, args=(remote, job, work), daemon=True)
    variables = dict(ONE_THREAD)
    if gpu:
        variables["CUDA_VISIBLE_DEVICES"] = gpus()[place % len(gpus())]
    with _environment(variables):  # libraries read them when they are imported
        process.start()
    remote.close()
    return _Worker(process, local, place)


@contextlib.contextmanager
def _environment(changes: dict[str, str]) -> Iterator[None]:
    """Set environment variables for the processes that the block starts."""
    before = {name: os.environ.get(name) for name in changes}
    os.environ.update(changes)
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value


def gpus() -> list[str]:
    """CUDA numbers of the NVIDIA graphics cards that this process may use; "0" where they cannot be listed."""
    visible = os.environ.get("CUDA_VISIBLE_DEVICES")
    if visible:
        return visible.split(",")
    devices = [path.name for path in Path("/dev").glob("nvidia*") if re.fullmatch(r"nvidia\d+", path.name)]
    return [str(number) for number in range(len(devices))] or ["0"]


def _stop(workers: list[_Worker]) -> None:
    """End processes, and kill those that do not end within ``STOP_S``."""
    for worker in workers:
        worker.connection.close()
        worker.process.terminate()
    for worker in workers:
        worker.process.join(STOP_S)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join(STOP_S)


def _serve(connection: Connection, job: Any, work: Work) -> None:
    """Work on the indices that arrive through a connection, until it closes or the coordinating process dies."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches all processes; the coordinator handles it
    with contextlib.suppress(EOFError, OSError, KeyboardInterrupt):
        while True:
            connection.send(work(job, connection.recv()))


def _exit_reason(code: int | None) -> str:
    """Name of the signal that ended a process, or its exit status."""
    if code is None:
        return "it does not answer"
    return signal.Signals(-code).name if code < 0 else f"exit status {code}"


# --- Ray -----------------------------------------------------------------------------------------


def ray(address: str, work: Work, *, gpu: bool = False) -> Executor:
    """Executor that runs on the nodes of a Ray cluster.

    Ray chooses the node of each index, and repeats the work on an index whose process or node dies, ``RAY_TRIES`` times
    in all. Relative paths are those of this process, on nodes that have its working folder. Raises InputError if Ray is
    not installed or does not answer.

    Args:
        address: ``auto`` for the cluster of this computer or of the variable RAY_ADDRESS, or ``ray://host:port``.
        work: function of a job and an index.
        gpu: whether the work on an index needs a graphics card, which ``PER_CARD`` processes share.
    """
    try:
        import ray as engine
    except ImportError:
        raise InputError(
            "--executor ray: needs Ray; install it with pip install -c constraints.txt -e '.[cluster]'"
        ) from None
    _check_answers(address)
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # otherwise Ray warns of a future change
    try:
        engine.init(address=address, log_to_driver=False, logging_level="ERROR", ignore_reinit_error=True)
    except Exception as error:  # connection errors of Ray, grpc and the operating system
        raise InputError(
            f"--address {address}: Ray does not answer: {describe_error(error)[:RAY_ERROR_LENGTH]}"
        ) from None

    def run(job: Any, queue: deque[int]) -> Generator[Outcome]:
        task = engine.remote(
            num_cpus=1,
            num_gpus=1 / PER_CARD if gpu else 0,
            max_retries=RAY_TRIES - 1,
            max_calls=0,  # a process works on many indices, and compiles its kernels once
            runtime_env={"env_vars": ONE_THREAD},
        )(_work_in)
        shared_job, folder = engine.put(job), os.getcwd()
        pending: dict[Any, int] = {}
        try:
            while queue or pending:
                most = 2 * max(int(engine.cluster_resources().get("CPU", 1)), 1)
                while queue and len(pending) < most:
                    index = queue.popleft()
                    pending[task.remote(folder, work, shared_job, index)] = index
                done, _ = engine.wait(list(pending), num_returns=1, timeout=POLL_S)
                for reference in done:
                    index = pending.pop(reference)
                    try:
                        yield engine.get(reference)
                    except engine.exceptions.RayError as error:
                        yield Outcome(
                            index, f"{describe_error(error)[:RAY_ERROR_LENGTH]} (in {RAY_TRIES} tries)", final=True
                        )
        finally:
            for reference in pending:
                engine.cancel(reference, force=True)

    return run


def _work_in(folder: str, work: Work, job: Any, index: int) -> Outcome:
    """Work in a folder, where the node has it."""
    if os.path.isdir(folder):
        os.chdir(folder)
    return work(job, index)


def _check_answers(address: str) -> None:
    """Raise InputError if no Ray client server listens at an address."""
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS", address)
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit() or int(port) >= 2**16:
        raise InputError(f"--address '{address}': is neither auto nor of the form ray://host:port")
    import grpc

    why = "it is not a Ray server"
    try:
        socket.create_connection((host, int(port)), timeout=RAY_ANSWER_S / 2).close()
        with grpc.insecure_channel(f"{host}:{port}") as channel:
            grpc.channel_ready_future(channel).result(timeout=RAY_ANSWER_S / 2)
            return
    except OSError as error:
        why = describe_error(error)
    except grpc.FutureTimeoutError:
        pass
    raise InputError(
        f"--address {address}: does not answer ({why}); is 'ray start --head' running there, and the port of its "
        "client server (10001 by default) open?"
    )
