"""A chain of filters, built from a list in the settings.

```toml
[[filters]]
name = "range"
max_m = 30.0

[[filters]]
name = "deskew"
```
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Annotated, Any

from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from semgraph.errors import SettingsError, known_names
from sensors.filters.context import UNKNOWN, ScanContext
from sensors.filters.deskewing import DeskewSettings, deskew
from sensors.filters.levelling import LevelSettings, level
from sensors.filters.limits import (
    FieldSettings,
    InvalidSettings,
    RangeSettings,
    limit_field,
    limit_range,
    read_codes,
)
from sensors.filters.neighbours import MedianSettings, ShadowSettings, remove_shadows, smooth
from sensors.measurements import LaserScan

FilterSettings = Annotated[
    RangeSettings
    | FieldSettings
    | InvalidSettings
    | MedianSettings
    | ShadowSettings
    | DeskewSettings
    | LevelSettings,
    Field(discriminator="name"),
]
"""One filter of a chain; a model takes `list[FilterSettings]`."""
ScanFilter = Callable[[LaserScan, ScanContext], LaserScan]
Chain = tuple[ScanFilter, ...]

_OF_SCAN: dict[type[BaseModel], Callable[[LaserScan, Any], LaserScan]] = {
    RangeSettings: limit_range,
    FieldSettings: limit_field,
    InvalidSettings: read_codes,
    MedianSettings: smooth,
    ShadowSettings: remove_shadows,
}
_OF_CONTEXT: dict[type[BaseModel], Callable[[LaserScan, Any, ScanContext], LaserScan]] = {
    DeskewSettings: deskew,
    LevelSettings: level,
}
_MODELS: dict[str, type[BaseModel]] = {
    model.model_fields["name"].default: model for model in (*_OF_SCAN, *_OF_CONTEXT)
}
_LIST: TypeAdapter[list[FilterSettings]] = TypeAdapter(list[FilterSettings])


def filter_names() -> list[str]:
    """All names that a filter's `name` can have, sorted."""
    return sorted(_MODELS)


def filter_settings(tables: Sequence[Mapping[str, object]]) -> list[FilterSettings]:
    """The checked settings of tables as a file has them.

    Raises:
        SettingsError: unknown filter or setting, or a value that a setting cannot take.
    """
    try:
        return _LIST.validate_python([dict(table) for table in tables])
    except (ValidationError, TypeError, ValueError) as error:
        raise SettingsError(_one_line(tables, error)) from error


def build_chain(settings: Sequence[FilterSettings]) -> Chain:
    """The filters, in the order in which they are applied."""
    return tuple(_built(one) for one in settings)


def apply_chain(chain: Chain, scan: LaserScan, context: ScanContext = UNKNOWN) -> LaserScan:
    """The scan after all filters of the chain; one whose input is not known changes nothing."""
    for scan_filter in chain:
        scan = scan_filter(scan, context)
    return scan


def _built(settings: FilterSettings) -> ScanFilter:
    with_context = _OF_CONTEXT.get(type(settings))
    if with_context is not None:
        return lambda scan, context: with_context(scan, settings, context)
    of_scan = _OF_SCAN[type(settings)]
    return lambda scan, _: of_scan(scan, settings)


def _one_line(tables: Sequence[Mapping[str, object]], error: Exception) -> str:
    """The first thing wrong with the list, and what to do."""
    if not isinstance(error, ValidationError):
        return f"filters: expected a list of tables with a name each, got {tables!r}"
    first = error.errors()[0]
    number, *path = first["loc"] or ("",)
    where = f"filters: {number}"
    if first["type"].startswith("union_tag"):
        name = first["input"].get("name", "")
        return f"{where}: unknown filter {name!r}, {known_names(str(name), filter_names())}"
    key = ".".join(str(part) for part in path[1:])
    where = f"{where} ({path[0]})" if path else where
    if first["type"] == "extra_forbidden":
        known = known_names(key, _MODELS[str(path[0])].model_fields)
        return f"{where}: unknown setting {key!r}, {known}"
    return f"{where}: {key}: {first['msg']}, got {first['input']!r}"
