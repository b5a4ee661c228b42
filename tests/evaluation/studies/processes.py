"""Processes that tests start and end."""

import os
import sys
import time
from collections.abc import Callable
from pathlib import Path

import psutil


def environment() -> dict[str, str]:
    """In which another Python finds what this one does."""
    path = os.pathsep.join(each or str(Path.cwd()) for each in sys.path)
    return {**os.environ, "PYTHONPATH": path}


def wait_until(holds: Callable[[], bool], seconds: float = 60.0) -> None:
    deadline = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < deadline, "it took too long"
        time.sleep(0.05)


def kill_tree(pid: int) -> None:
    """A process and all below it; what is gone already is fine."""
    try:
        process = psutil.Process(pid)
        tree = [process, *process.children(recursive=True)]
    except psutil.NoSuchProcess:
        return
    for each in tree:
        try:
            each.kill()
        except psutil.NoSuchProcess:
            continue
