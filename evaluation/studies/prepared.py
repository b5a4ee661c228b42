"""`measure`, with all estimators imported: processes that fork for each trial import them once."""

from evaluation.estimators.catalog import ESTIMATORS
from evaluation.studies.measuring import measure

__all__ = ["measure"]

for _entry in ESTIMATORS.values():
    _entry.load()
