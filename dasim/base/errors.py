"""The exception for wrong input of the user, and errors in one line.

Tested in tests/dasim/base/test_loading.py.
"""

LONGEST, LONGEST_VALUE = 6000, 60  # characters of a message, and of a value in it


class InputError(ValueError):
    """The user's input is wrong; the message is one line: what, where, what is allowed.

    The command line prints the message and ends with status 2. Every other exception is a defect of the program and
    keeps its traceback.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def one_line(message: str) -> str:
    """A message as one line that a terminal can show: control characters escaped, and cut in its middle if long."""
    text = " ".join(message.split())
    text = "".join(c if c.isprintable() else c.encode("unicode_escape", "backslashreplace").decode() for c in text)
    if len(text) <= LONGEST:
        return text
    gap, end = " ... ", LONGEST // 3
    return f"{text[: LONGEST - len(gap) - end]}{gap}{text[-end:]}"


def shortened(value: object) -> str:
    """A value for a message, at most ``LONGEST_VALUE`` characters."""
    text = repr(value) if not isinstance(value, int) or abs(value) < 10**LONGEST_VALUE else "a longer number"
    return text if len(text) <= LONGEST_VALUE else f"{text[: LONGEST_VALUE - 3]}..."


def kind_of(value: object) -> str:
    """Description of a value of the wrong type for a message: ``None``, ``the int 3``, ``a Scene``."""
    if value is None:
        return "None"
    name = type(value).__name__
    if isinstance(value, (bool, int, float, str)):
        return f"the {name} {shortened(value)}"
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"


def describe_error(error: BaseException) -> str:
    """Message of an error as one line: type and text, or the text alone of an InputError or OSError."""
    if isinstance(error, OSError) and error.strerror:
        return error.strerror + (f" ({error.filename})" if error.filename else "")
    return " ".join((str(error) if isinstance(error, InputError) else f"{type(error).__name__}: {error}").split())
