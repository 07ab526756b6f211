"""Where the samples of a dataset are made: in processes of this computer, or by Ray on many.

An executor takes indices from a queue until it is empty, and yields an outcome for each; who reads them may put an
index back to have it tried again.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import resource
import signal
import socket
import sys
from collections import deque
from collections.abc import Callable, Generator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from typing import Any

from dasim.dataset import sample, storage
from dasim.dataset.sample import Job
from dasim.errors import InputError

RAY_ANSWER_S = 10.0
RAY_TRIES = 3
STOP_S = 5.0  # that a process gets to end by itself
LOOK_S = 0.5
PART = "parts/{}.tar"


@dataclass(frozen=True)
class Outcome:
    """What became of a sample."""

    index: int
    error: str | None = None  # why it was not made
    fatal: bool = False  # the same would happen to every other one
    final: bool = False  # it was tried often enough
    seconds: float = 0.0
    render_s: float = 0.0
    peak_mb: float = 0.0  # largest memory of the process so far
    row: dict[str, Any] | None = None


Work = Callable[[Any, int], "Outcome"]  # a job, which pickles, and an index: what became of it
Executor = Callable[[Any, "deque[int]"], Generator["Outcome"]]


def work(job: Job, index: int) -> Outcome:
    """Make a sample in this process and write it; an error is an outcome, not raised."""
    try:
        sample.activate(job.environment["variant"])
        here = sample.environment(job.environment["variant"])
        if here != job.environment:
            differing = ", ".join(key for key in here if here[key] != job.environment[key])
            return Outcome(index, f"this worker has another {differing} than the dataset: pixels would differ", True)
        made = sample.make(job.spec, index, job.environment["variant"])
        members = {**made.files, sample.ROW: sample.plain(made.row)}
        storage.write(job.out, PART.format(sample.key(index)), sample.packed(members))
    except OSError as error:
        return Outcome(index, f"{error.strerror or error} ({error.filename or job.out})", error.errno in storage.FULL)
    except Exception as error:
        said = str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}"
        return Outcome(index, " ".join(said.split()))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
    return Outcome(index, None, False, False, made.seconds, made.render_s, peak, made.row)


# --- processes of this computer ------------------------------------------------------------------


def local(processes: int, work: Work = work) -> Executor:
    """Processes of this computer; one that dies is replaced, and only its own sample has failed."""

    def run(job: Any, queue: deque[int]) -> Generator[Outcome]:
        context = multiprocessing.get_context("spawn")
        workers: dict[Connection, tuple[BaseProcess, int]] = {}
        idle: list[tuple[Connection, BaseProcess]] = []
        number = 0
        try:
            while queue or workers:
                while queue and len(workers) < processes:
                    if not idle:
                        idle.append(_started(context, work, job, number))
                        number += 1
                    connection, process = idle.pop()
                    index = queue.popleft()
                    with contextlib.suppress(OSError):  # it died while it waited: found below
                        connection.send(index)
                    workers[connection] = (process, index)
                for ready in wait(list(workers), timeout=LOOK_S):
                    assert isinstance(ready, Connection)
                    process, index = workers.pop(ready)
                    try:
                        yield ready.recv()
                        idle.append((ready, process))
                    except (EOFError, OSError):
                        process.join(STOP_S)
                        yield Outcome(index, f"the process that made it died ({_death(process.exitcode)})")
        finally:
            everyone = [process for process, _ in workers.values()] + [process for _, process in idle]
            for connection in [*workers, *(connection for connection, _ in idle)]:
                connection.close()
            for process in everyone:
                process.terminate()
            for process in everyone:
                process.join(STOP_S)
                if process.is_alive():
                    process.kill()

    return run


def _started(context: Any, work: Work, job: Any, number: int) -> tuple[Connection, BaseProcess]:
    near, far = context.Pipe()
    process = context.Process(target=_serve, args=(far, work, job, number), daemon=True)
    process.start()
    far.close()
    return near, process


def _serve(connection: Connection, work: Work, job: Any, number: int) -> None:
    """A worker: makes what it is asked for until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the one who asks decides
    if job.environment["variant"].startswith("cuda"):
        gpus = (os.environ.get("CUDA_VISIBLE_DEVICES") or "0").split(",")
        os.environ["CUDA_VISIBLE_DEVICES"] = gpus[number % len(gpus)]
    with contextlib.suppress(EOFError, OSError, KeyboardInterrupt):
        while True:
            connection.send(work(job, connection.recv()))


def _death(code: int | None) -> str:
    if code is None:
        return "it does not answer"
    return signal.Signals(-code).name if code < 0 else f"exit status {code}"


# --- Ray -----------------------------------------------------------------------------------------


def ray(address: str, work: Work = work) -> Executor:
    """The nodes of a Ray cluster: ``auto`` for the one of this computer, or ``ray://host:port``.

    Ray places, and after the death of a worker or node repeats, each sample. Raises InputError where Ray is not
    installed or does not answer.
    """
    try:
        import ray as engine
    except ImportError:
        raise InputError("--executor ray: needs Ray; install it with pip install 'dasim[cluster]'") from None
    _check_answers(address)
    try:
        engine.init(address=address, log_to_driver=False, logging_level="ERROR", ignore_reinit_error=True)
    except Exception as error:  # connection errors of Ray, grpc and the operating system
        first = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"--address {address}: Ray does not answer: {first}") from None

    def run(job: Any, queue: deque[int]) -> Generator[Outcome]:
        gpus = 1 if job.environment["variant"].startswith("cuda") else 0
        task = engine.remote(num_cpus=1, num_gpus=gpus, max_retries=RAY_TRIES - 1)(work)
        sent = engine.put(job)
        pending: dict[Any, int] = {}
        try:
            while queue or pending:
                most = 2 * max(int(engine.cluster_resources().get("CPU", 1)), 1)
                while queue and len(pending) < most:
                    index = queue.popleft()
                    pending[task.remote(sent, index)] = index
                done, _ = engine.wait(list(pending), num_returns=1, timeout=LOOK_S)
                for reference in done:
                    index = pending.pop(reference)
                    try:
                        yield engine.get(reference)
                    except engine.exceptions.RayError as error:
                        said = " ".join(str(error).split())[:300]
                        yield Outcome(index, f"{type(error).__name__} in {RAY_TRIES} tries: {said}", final=True)
        finally:
            for reference in pending:
                engine.cancel(reference, force=True)

    return run


def _check_answers(address: str) -> None:
    """InputError where nobody listens at an address."""
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit():
        raise InputError(f"--address '{address}': is neither auto nor of the form ray://host:port")
    try:
        socket.create_connection((host, int(port)), timeout=RAY_ANSWER_S).close()
    except OSError as error:
        raise InputError(
            f"--address {address}: Ray does not answer within {RAY_ANSWER_S:g} s ({error.strerror or error}); is "
            "'ray start --head' running there, and the port open?"
        ) from None
