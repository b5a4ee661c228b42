"""What all tests share: the place of the real recordings, and leaving out what needs them."""

from pathlib import Path

import pytest
from hypothesis import settings

SHARED_DATA = Path(__file__).resolve().parents[2] / "shared" / "data"

# The same examples in every run, so that a failure can be run again.
settings.register_profile("seeded", derandomize=True)
settings.load_profile("seeded")


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    if SHARED_DATA.is_dir():
        return
    leave_out = pytest.mark.skip(reason=f"needs the recordings in {SHARED_DATA}")
    for item in items:
        if item.get_closest_marker("shared_data"):
            item.add_marker(leave_out)


@pytest.fixture
def shared_data() -> Path:
    """The folder of the real recordings; use with @pytest.mark.shared_data."""
    return SHARED_DATA
