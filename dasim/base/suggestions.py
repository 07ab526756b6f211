"""Suggestions for mistyped names, for the messages of errors."""

from __future__ import annotations

import difflib
from collections.abc import Iterable

LIKENESS = 0.6  # least ratio of difflib of a name that is suggested


def did_you_mean(name: object, known: Iterable[str], most: int = 1) -> str:
    """The end of a message on an unknown name, ``; did you mean 'desk'?``; empty where no known name is near.

    Args:
        name: what the user gave; text other than a string has no suggestion.
        known: names that are allowed, in order of preference.
        most: number of names that are suggested at most, the nearest first.
    """
    if not isinstance(name, str):
        return ""
    spelled: dict[str, str] = {}
    for text in known:
        spelled.setdefault(text.lower(), text)
    near = [spelled[text] for text in difflib.get_close_matches(name.lower(), spelled, most, LIKENESS)]
    return f"; did you mean {' or '.join(repr(text) for text in near)}?" if near else ""
