"""Where commands print: names and paths as they are."""

from rich.console import Console


def terminal() -> Console:
    """Nothing printed there is markup: a folder may be called `[a]`, and a course `:eight`."""
    return Console(soft_wrap=True, markup=False, emoji=False)
