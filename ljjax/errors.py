"""What ljjax raises for input it cannot use: one line that names the place and the mend."""


class InputError(ValueError):
    """Bad input or usage. The message is one line: the file, the place, what was found, and the mend.

    The command line prints it on stderr and exits with 2.
    """

    def __init__(self, message: str):
        super().__init__(" ".join(str(message).split()))


class SolverError(RuntimeError):
    """A simulation that did not reach its end. The message is one line: the place, what happened, and what to try.

    The command line prints it on stderr and exits with 1.
    """
