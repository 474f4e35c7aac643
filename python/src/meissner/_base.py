"""The errors that `results` and what it imports raise; `errors` has them with all others."""


class MeissnerError(Exception):
    """Everything that this package raises on purpose."""

    __module__ = "meissner.errors"


class NotKnownYet(MeissnerError):
    """The play has not come so far: call `wait()` first."""

    __module__ = "meissner.errors"
