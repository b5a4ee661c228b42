"""Detectors by name, loaded when asked for: those of this package and those of entry points."""

from collections.abc import Mapping
from difflib import get_close_matches
from importlib.metadata import EntryPoint, entry_points
from typing import Any

from pydantic import BaseModel, ValidationError

from detectors.detector import Detector, DetectorType
from semgraph.errors import SettingsError

ENTRY_POINT_GROUP = "semgraph.detectors"
_OWN = {
    "optical-markers": "detectors.optical_markers:OPTICAL_MARKERS",
    "reflectors": "detectors.reflectors:REFLECTORS",
    "rocks": "detectors.rocks:ROCKS",
    "trees-2d": "detectors.trees_2d:TREES",
    "trees-3d": "detectors.trees_3d:TREES_3D",
}


def detector_names() -> list[str]:
    """All names that `create_detector` takes, sorted. Nothing is imported."""
    return sorted(_known())


def detector_settings(name: str) -> type[BaseModel]:
    """The settings model of a detector.

    Raises:
        SettingsError: unknown name, or an entry point that cannot be loaded.
    """
    return detector_type(name).settings


def detector_type(name: str) -> DetectorType:
    """What there is to know of a detector before it is built.

    Raises:
        SettingsError: unknown name, or an entry point that cannot be loaded.
    """
    known = _known()
    if name not in known:
        raise SettingsError(f"detector: unknown name {name!r}; {_nearest(name, known)}")
    point = known[name]
    try:
        kind = point.load()
    except (ImportError, AttributeError) as error:
        raise SettingsError(f"detector {name}: cannot load {point.value}: {error}") from error
    if not isinstance(kind, DetectorType):
        raise SettingsError(
            f"detector {name}: expected {point.value} to be a DetectorType, got {kind!r}"
        )
    return kind


def create_detector(name: str, settings: Mapping[str, object]) -> Detector[Any]:
    """A detector built from `settings`; what is left out has its default.

    Raises:
        SettingsError: unknown name or setting, a value that a setting cannot take.
    """
    kind = detector_type(name)
    try:
        checked = kind.settings.model_validate(dict(settings))
    except ValidationError as error:
        raise SettingsError(_one_line(name, kind.settings, error)) from error
    return kind.build(checked)


def _known() -> dict[str, EntryPoint]:
    """Entry points by name; a name of this package cannot be taken by another."""
    outside = {point.name: point for point in entry_points(group=ENTRY_POINT_GROUP)}
    own = {name: EntryPoint(name, value, ENTRY_POINT_GROUP) for name, value in _OWN.items()}
    return outside | own


def _one_line(name: str, settings: type[BaseModel], error: ValidationError) -> str:
    """The first thing wrong with the settings, and what to do."""
    first = error.errors()[0]
    key = ".".join(str(part) for part in first["loc"]) or "settings"
    if first["type"] == "extra_forbidden":
        return f"detector {name}: unknown setting {key!r}; {_nearest(key, settings.model_fields)}"
    return f"detector {name}: {key}: {first['msg']}, got {first['input']!r}"


def _nearest(name: str, known: Mapping[str, object]) -> str:
    close = get_close_matches(name, known, n=1)
    return f"did you mean {close[0]!r}?" if close else f"known: {', '.join(sorted(known))}"
