"""The one exception a user's mistake raises."""


class InputError(ValueError):
    """The user's input is wrong; the message is one line: what, where, what is allowed.

    The command line prints the message and ends with status 2; every other exception is a
    defect of the program and keeps its traceback.
    """

    def __init__(self, message: str) -> None:
        super().__init__(" ".join(message.split()))
