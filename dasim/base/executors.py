"""Where the samples of a dataset are made: in processes of this computer, or by Ray on many.

An executor takes indices from a queue until it is empty, and yields an outcome for each; who reads them may put an
index back to have it tried again.

Tested in tests/dasim/dataset/test_make.py and tests/dasim/dataset/test_ray.py.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import os
import re
import resource
import shutil
import signal
import socket
import sys
import tempfile
from collections import deque
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

from dasim.base.errors import InputError
from dasim.dataset import sample, storage
from dasim.dataset.sample import Job

RAY_ANSWER_S = 10.0
RAY_TRIES = 3
STOP_S = 5.0  # that a process gets to end by itself
LOOK_S = 0.5
SCRATCH_BYTES = 200e6  # that writing a sample needs of the temporary folder, at most
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


Work = Callable[[Any, int], Outcome]  # a job, which pickles, and an index: what became of it
Executor = Callable[[Any, "deque[int]"], Generator[Outcome]]


def work(job: Job, index: int) -> Outcome:
    """Make a sample in this process and write it; an error is an outcome, not raised.

    What goes wrong in the making is the sample's own; where files cannot be written, no other sample could be.
    """
    try:
        sample.activate(job.environment["variant"])
        here = sample.environment(job.environment["variant"])
        if here != job.environment:
            differing = ", ".join(key for key in here if here[key] != job.environment.get(key))
            return Outcome(index, f"this worker has another {differing} than the dataset: pixels would differ", True)
        made = sample.make(job.spec, index, job.environment["variant"])
    except Exception as error:
        if shutil.disk_usage(tempfile.gettempdir()).free < SCRATCH_BYTES:
            return Outcome(index, f"the temporary folder {tempfile.gettempdir()} is full", fatal=True)
        return Outcome(index, said(error))
    try:
        members = {**made.files, sample.ROW: sample.plain(made.row)}
        storage.write(job.out, PART.format(sample.key(index)), sample.packed(members))
    except Exception as error:  # each store raises its own
        return Outcome(index, f"cannot be written: {said(error)}", fatal=True)
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / (1e6 if sys.platform == "darwin" else 1e3)
    return Outcome(index, None, False, False, made.seconds, made.render_s, peak, made.row)


def said(error: Exception) -> str:
    """An error in one line."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror + (f" ({error.filename})" if error.filename else "")
    return " ".join((str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}").split())


# --- processes of this computer ------------------------------------------------------------------


@dataclass(frozen=True)
class _Worker:
    process: BaseProcess
    connection: Connection
    place: int  # of so many; a new one takes the place of one that died, and its GPU


def local(processes: int, work: Work = work) -> Executor:
    """Processes of this computer; one that dies is replaced, and only its own sample has failed."""

    def run(job: Any, queue: deque[int]) -> Generator[Outcome]:
        busy: dict[Connection, tuple[_Worker, int]] = {}
        idle: list[_Worker] = []
        places = list(range(processes))
        try:
            while queue or busy:
                while queue and len(busy) < processes:
                    worker = idle.pop() if idle else _started(job, places.pop(), work)
                    index = queue.popleft()
                    with contextlib.suppress(OSError):  # it died while it waited: found below
                        worker.connection.send(index)
                    busy[worker.connection] = (worker, index)
                for ready in wait(list(busy), timeout=LOOK_S):
                    assert isinstance(ready, Connection)
                    worker, index = busy.pop(ready)
                    try:
                        outcome = ready.recv()
                        idle.append(worker)
                    except (EOFError, OSError):
                        worker.process.join(STOP_S)
                        places.append(worker.place)
                        ready.close()
                        outcome = Outcome(index, f"the process that made it died ({_death(worker.process.exitcode)})")
                    yield outcome
        finally:
            _stop([worker for worker, _ in busy.values()] + idle)

    return run


def _started(job: Any, place: int, work: Work) -> _Worker:
    context = multiprocessing.get_context("spawn")
    near, far = context.Pipe()
    process = context.Process(target=_serve, args=(far, job, work), daemon=True)
    variables = dict(sample.ONE_THREAD)
    if job.environment["variant"].startswith("cuda"):
        variables["CUDA_VISIBLE_DEVICES"] = gpus()[place % len(gpus())]
    with _variables(variables):  # read when libraries are loaded, before anything of ours runs
        process.start()
    far.close()
    return _Worker(process, near, place)


@contextlib.contextmanager
def _variables(changes: dict[str, str]) -> Iterator[None]:
    """Variables for processes that are started meanwhile."""
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
    """NVIDIA graphics cards that this process may use, as CUDA numbers them; the first one where nobody knows."""
    given = os.environ.get("CUDA_VISIBLE_DEVICES")
    if given:
        return given.split(",")
    found = [path.name for path in Path("/dev").glob("nvidia*") if re.fullmatch(r"nvidia\d+", path.name)]
    return [str(number) for number in range(len(found))] or ["0"]


def _stop(workers: list[_Worker]) -> None:
    for worker in workers:
        worker.connection.close()
        worker.process.terminate()
    for worker in workers:
        worker.process.join(STOP_S)
        if worker.process.is_alive():
            worker.process.kill()
            worker.process.join(STOP_S)


def _serve(connection: Connection, job: Any, work: Work) -> None:
    """A worker: makes what it is asked for until nobody asks any more."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C goes to all; the one who asks decides
    with contextlib.suppress(EOFError, OSError, KeyboardInterrupt):
        while True:
            connection.send(work(job, connection.recv()))


def _death(code: int | None) -> str:
    if code is None:
        return "it does not answer"
    return signal.Signals(-code).name if code < 0 else f"exit status {code}"


# --- Ray -----------------------------------------------------------------------------------------


def ray(address: str, work: Work = work) -> Executor:
    """The nodes of a Ray cluster: ``auto`` for the one of this computer or of RAY_ADDRESS, or ``ray://host:port``.

    Ray places, and after the death of a worker or node repeats, each sample. Raises InputError where Ray is not
    installed or does not answer.
    """
    try:
        import ray as engine
    except ImportError:
        raise InputError("--executor ray: needs Ray; install it with pip install 'dasim[cluster]'") from None
    _check_answers(address)
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")  # else it warns of a change to come
    try:
        engine.init(address=address, log_to_driver=False, logging_level="ERROR", ignore_reinit_error=True)
    except Exception as error:  # connection errors of Ray, grpc and the operating system
        raise InputError(f"--address {address}: Ray does not answer: {said(error)[:300]}") from None

    def run(job: Any, queue: deque[int]) -> Generator[Outcome]:
        gpus = 1 if job.environment["variant"].startswith("cuda") else 0
        task = engine.remote(
            num_cpus=1,
            num_gpus=gpus,
            max_retries=RAY_TRIES - 1,
            max_calls=0,  # a process makes many: kernels are compiled once
            runtime_env={"env_vars": sample.ONE_THREAD},
        )(work)
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
                        yield Outcome(index, f"{said(error)[:300]} (in {RAY_TRIES} tries)", final=True)
        finally:
            for reference in pending:
                engine.cancel(reference, force=True)

    return run


def _check_answers(address: str) -> None:
    """InputError where nobody who speaks Ray's protocol listens at an address."""
    if address == "auto":
        address = os.environ.get("RAY_ADDRESS", address)
    if address == "auto":
        return
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not host or not port.isdigit() or int(port) >= 2**16:
        raise InputError(f"--address '{address}': is neither auto nor of the form ray://host:port")
    import grpc

    why = "no Ray is there"
    try:
        socket.create_connection((host, int(port)), timeout=RAY_ANSWER_S / 2).close()
        with grpc.insecure_channel(f"{host}:{port}") as channel:
            grpc.channel_ready_future(channel).result(timeout=RAY_ANSWER_S / 2)
            return
    except OSError as error:
        why = said(error)
    except grpc.FutureTimeoutError:
        pass
    raise InputError(
        f"--address {address}: does not answer ({why}); is 'ray start --head' running there, and the port of its "
        "client server (10001 by default) open?"
    )
