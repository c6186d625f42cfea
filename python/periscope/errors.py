"""Exceptions of the package.

Each message says what is wrong, where, and what to do. Wrong arguments are ``ValueError``, ``IndexError`` or
``KeyError``; what the system refuses is ``OSError``; Ctrl-C is ``KeyboardInterrupt``.
"""

from __future__ import annotations

__all__ = [
    "CampaignError",
    "FormatError",
    "PeriscopeError",
    "PipelineError",
    "ResultsError",
    "RunError",
    "UndeterminedError",
]


class PeriscopeError(Exception):
    """All errors of the package that are not those of Python."""


class FormatError(PeriscopeError):
    """A file is in no known format, or contradicts itself.

    Attributes
    ----------
    file : str
        The file.
    byte_offset : int or None
        Where in the file, if in one place.
    line : int or None
        Line of a text file, from 1.
    """

    def __init__(self, message: str, file: str, byte_offset: int | None, line: int | None) -> None:
        super().__init__(message)
        self.file = file
        self.byte_offset = byte_offset
        self.line = line

    def __reduce__(self) -> tuple[type[FormatError], tuple[str, str, int | None, int | None]]:
        """Pickles with all arguments, so that the error passes between processes."""
        return type(self), (str(self), self.file, self.byte_offset, self.line)


class CampaignError(PeriscopeError):
    """A campaign folder, its campaign.toml, or a scene to simulate is wrong."""


class PipelineError(PeriscopeError):
    """A pipeline, its file, or a parameter of it is wrong."""


class RunError(PeriscopeError):
    """A run cannot go on. What was finished is kept; the same call goes on from there."""


class ResultsError(PeriscopeError):
    """A result folder is none, is in use, or is damaged; or it has no such row."""


class UndeterminedError(PeriscopeError):
    """The arguments are well-formed, but do not determine what is asked for."""
