"""Work of an executor on one index of a dataset: making and writing one sample.

Tested in tests/dasim/dataset/test_make.py.
"""

from __future__ import annotations

import shutil
import tempfile

from dasim.base.errors import InputError, describe_error
from dasim.base.executors import Outcome
from dasim.base.memory import peak_bytes
from dasim.dataset import sample, storage, tar_files
from dasim.dataset.plan import SUMS
from dasim.dataset.sample import Job

SCRATCH_BYTES = 200e6  # most space in the temporary folder that writing a sample needs
PART = "parts/{}.tar"  # file of a sample until its shard is complete


def work(job: Job, index: int) -> Outcome:
    """Make a sample in this process and write it to the dataset; errors are returned as outcomes, not raised.

    An error of the simulation concerns this sample only. A file that cannot be written is fatal, because the files of
    other samples could not be written either.
    """
    try:
        sample.activate(job.environment["variant"])
        here = sample.provenance(job.environment["variant"])
        if here != job.environment:
            keys = ", ".join(key for key in here if here[key] != job.environment.get(key))
            return Outcome(index, f"this worker differs from the dataset in {keys}: pixels would differ", True)
        result = sample.make(job.spec, index, job.environment["variant"])
    except InputError as error:  # the same at every try
        return Outcome(index, describe_error(error), final=True)
    except Exception as error:
        if shutil.disk_usage(tempfile.gettempdir()).free < SCRATCH_BYTES:
            return Outcome(index, f"the temporary folder {tempfile.gettempdir()} is full", fatal=True)
        return Outcome(index, describe_error(error))
    try:
        members = {**result.files, sample.ROW: sample.json_bytes(result.row)}
        part = PART.format(sample.key(index))
        storage.write(job.out, part, tar_files.pack(members))
        if storage.exists(job.out, SUMS):  # its run was killed, and another finished the dataset meanwhile
            storage.remove(job.out, part)
    except Exception as error:  # stores raise errors of their own types
        return Outcome(index, f"cannot be written: {describe_error(error)}", fatal=True)
    return Outcome(index, None, False, False, result.seconds, result.render_s, peak_bytes() / 1e6, result.row)
