"""What this library raises and warns with."""

from __future__ import annotations


class McaaError(ValueError):
    """Something a user passed, or a user's function returned, cannot be used; the message says what, and the mend."""


class McaaWarning(UserWarning):
    """The result stands, but not for everything that was asked."""
