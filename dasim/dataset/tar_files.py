"""Tar files that depend on their members' names and bytes alone.

Tested in tests/dasim/dataset/test_make.py.
"""

from __future__ import annotations

import io
import tarfile


def add(tar: tarfile.TarFile, name: str, content: bytes) -> None:
    """Append a member to a tar file, without time or owner, so that equal content gives equal bytes."""
    info = tarfile.TarInfo(name)
    info.size, info.mode = len(content), 0o644
    tar.addfile(info, io.BytesIO(content))


def pack(members: dict[str, bytes]) -> bytes:
    """Tar file of members (bytes by name) in their order."""
    buffer = io.BytesIO()
    with tarfile.open(fileobj=buffer, mode="w", format=tarfile.USTAR_FORMAT) as tar:
        for name, content in members.items():
            add(tar, name, content)
    return buffer.getvalue()


def unpack(data: bytes) -> dict[str, bytes]:
    """Members (bytes by name) of a tar file."""
    members = {}
    with tarfile.open(fileobj=io.BytesIO(data), mode="r:") as tar:
        for info in tar:
            member = tar.extractfile(info)
            if member is not None:
                members[info.name] = member.read()
    return members
