"""A folder written whole or not at all."""

import secrets
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import datetime
from pathlib import Path

from semgraph.errors import SemgraphError

LATEST = "latest"


@contextmanager
def staged_folder(folder: Path, marker: str) -> Iterator[Path]:
    """A fresh sibling of `folder` to write into; it takes its name when the block ends well.

    An earlier folder is replaced if it is empty or has a file `marker`, which tells that this
    program wrote it. After an error nothing of the new folder is left, nor an empty parent, and
    the earlier one stands.

    Raises:
        SemgraphError: `folder` cannot be written, or holds something else.
    """
    try:
        folder = folder.resolve()
        _check_replaceable(folder, marker)
        is_parent_new = not folder.parent.exists()
        folder.parent.mkdir(parents=True, exist_ok=True)
        staging = folder.parent / f".{folder.name}.{secrets.token_hex(4)}"
        staging.mkdir()
    except (OSError, RuntimeError, ValueError) as error:
        raise SemgraphError(f"{folder}: cannot be written: {_reason(error)}") from error
    try:
        yield staging
        _take_name(staging, folder)
    finally:
        shutil.rmtree(staging, ignore_errors=True)
        if is_parent_new and not any(folder.parent.iterdir()):
            folder.parent.rmdir()


def new_results_folder(root: Path, now: datetime) -> Path:
    """The path of a folder in `root` that is not there yet, named after the time."""
    stem = now.strftime("%Y-%m-%dT%H-%M-%S")
    folder, number = root / stem, 1
    while folder.exists():
        number += 1
        folder = root / f"{stem}-{number}"
    return folder


def point_latest(folder: Path) -> str | None:
    """Lets the link `latest` beside a results folder point to it.

    Returns:
        None, or the reason why there is no such link, in one line.
    """
    link = folder.parent / LATEST
    fresh = folder.parent / f".{LATEST}.{secrets.token_hex(4)}"
    try:
        fresh.symlink_to(folder.name, target_is_directory=True)
        fresh.replace(link)
    except OSError as error:
        fresh.unlink(missing_ok=True)
        return f"{link}: the link could not be made: {_reason(error)}"
    return None


def _check_replaceable(folder: Path, marker: str) -> None:
    standing = next(path for path in (folder, *folder.parents) if path.exists())
    if not standing.is_dir():
        raise SemgraphError(f"{standing}: expected a folder, it is a file; choose another")
    if standing == folder and any(folder.iterdir()) and not (folder / marker).is_file():
        raise SemgraphError(
            f"{folder}: expected a new or empty folder or earlier results (with {marker}), "
            "it holds something else; choose another"
        )


def _take_name(staging: Path, folder: Path) -> None:
    earlier = staging.with_name(f"{staging.name}.earlier")
    try:
        if folder.exists():
            folder.rename(earlier)
        try:
            staging.rename(folder)
        except OSError:
            if earlier.exists():
                earlier.rename(folder)
            raise
    except OSError as error:
        raise SemgraphError(f"{folder}: cannot be written: {_reason(error)}") from error
    shutil.rmtree(earlier, ignore_errors=True)


def _reason(error: Exception) -> str:
    return error.strerror if isinstance(error, OSError) and error.strerror else str(error)
