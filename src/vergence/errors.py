"""The one exception for whatever a user can mend."""


class VergenceError(Exception):
    """What was asked, what was found, and what would be right, in one sentence.

    The command line prints it without a traceback and exits with 2.
    """
