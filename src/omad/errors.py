"""The one exception that means: the input is at fault, and here is what to do about it."""


class InputError(ValueError):
    """Bad input. The message is one line that names the file or field and the cure; the command line exits with 2."""
