"""The errors a user can meet; each says what was expected, what came, and what to do."""


class SemgraphError(Exception):
    """A known error: the command line prints its one line and exits with 1."""


class InputError(SemgraphError):
    """Something from outside (a file, an array, a name) is not what was promised."""


class SettingsError(InputError):
    """A setting is unknown or has a value that it cannot take."""


class GraphError(SemgraphError):
    """The factor graph could not be built or solved."""
