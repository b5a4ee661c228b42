"""The errors a user can meet; each says what was expected, what came, and what to do."""

import difflib
from collections.abc import Iterable


class SemgraphError(Exception):
    """A known error: the command line prints its one line and exits with 1."""


class InputError(SemgraphError):
    """Something from outside (a file, an array, a name) is not what was promised."""


class SettingsError(InputError):
    """A setting is unknown or has a value that it cannot take."""


class GraphError(SemgraphError):
    """The factor graph could not be built or solved."""


def known_names(name: str, known: Iterable[str]) -> str:
    """The end of an error about an unknown name: the nearest known one, then all of them."""
    names = sorted(known)
    nearest = difflib.get_close_matches(name, names, n=1, cutoff=0.5)
    hint = f"did you mean {nearest[0]!r}? " if nearest else ""
    return f"{hint}known: {', '.join(names) or 'none'}"
