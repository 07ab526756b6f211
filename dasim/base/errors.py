"""The one exception a user's mistake raises.

Tested in tests/dasim/base/test_loading.py.
"""


class InputError(ValueError):
    """The user's input is wrong; the message is one line: what, where, what is allowed.

    The command line prints the message and ends with status 2; every other exception is a
    defect of the program and keeps its traceback.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))


def kind_of(value: object) -> str:
    """A value of the wrong kind, for a message: ``None``, ``the int 3``, ``a Scene``."""
    if value is None:
        return "None"
    name = type(value).__name__
    if isinstance(value, (bool, int, float, str)):
        return f"the {name} {value!r}"
    return f"{'an' if name[0] in 'AEIOUaeiou' else 'a'} {name}"
