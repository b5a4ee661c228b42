"""Sources by name or by what lies in a folder; a reader is imported only when it is asked for."""

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, cast

from pydantic import BaseModel, ValidationError

from semgraph.errors import InputError, SettingsError, known_names
from sensors.truth import Source


class _Read(Protocol):
    def __call__(self, place: object, options: BaseModel) -> Source: ...


def _folder(text: str) -> Path:
    folder = Path(text)
    if not _is_folder(folder):
        raise InputError(f"{text}: expected a folder, there is none")
    return folder


def _gtsam_data(text: str) -> Path:
    from sensors.victoria_park_graph import gtsam_data

    return _folder(text) if text else gtsam_data()


@dataclass(frozen=True, slots=True)
class _Entry:
    """A module with `read(place, options)`, its options' class, and what its place is.

    `place` turns what stands behind `name:` into the first argument of `read`. Modules whose place
    is a folder also have `recognises(folder)`.
    """

    module: str
    options: str
    place: Callable[[str], object] = _folder
    needs_place: bool = True

    def options_class(self) -> type[BaseModel]:
        return cast(type[BaseModel], getattr(importlib.import_module(self.module), self.options))

    def read(self, text: str, options: BaseModel) -> Source:
        read = cast(_Read, importlib.import_module(self.module).read)
        return read(self.place(text), options)

    def recognises(self, folder: Path) -> bool:
        return bool(importlib.import_module(self.module).recognises(folder))


def _course(name: str, options: str) -> _Entry:
    """A module of `sensors.simulation.courses`; its place is what the course is called."""
    module = f"sensors.simulation.courses.{name.replace('-', '_')}"
    return _Entry(module, options, lambda _: f"course:{name}", needs_place=False)


_ENTRIES = {
    "car-park": _Entry("sensors.car_park", "CarParkOptions"),
    "victoria-park": _Entry("sensors.victoria_park", "VictoriaParkOptions"),
    "victoria-park-graph": _Entry(
        "sensors.victoria_park_graph", "VictoriaParkGraphOptions", _gtsam_data, needs_place=False
    ),
    "mrclam": _Entry("sensors.mrclam", "MrclamOptions"),
    "wild-places": _Entry("sensors.wild_places", "WildPlacesOptions"),
    "plain": _Entry("sensors.plain_folder", "PlainOptions"),
    "course:perceptions": _course("perceptions", "CourseOptions"),
    "course:paper": _course("paper", "PaperOptions"),
    "course:forest": _course("forest", "ForestOptions"),
    "course:eight": _course("eight", "EightOptions"),
    "course:lanes": _course("lanes", "LanesOptions"),
    "course:rocks": _course("rocks", "RocksOptions"),
    "course:car-park": _course("car-park", "CarParkOptions"),
    "course:markers": _course("markers", "MarkersOptions"),
}
_FOLDER_PLACES = (_folder, _gtsam_data)


def source_names() -> tuple[str, ...]:
    """What can be opened by name; those that read a folder as NAME:FOLDER or by the folder."""
    return tuple(_ENTRIES)


def source_options(source: str) -> type[BaseModel]:
    """The options that a source takes.

    Raises:
        InputError: as `open_source`.
    """
    entry, _ = _resolve(source)
    return entry.options_class()


def check_options(source: str, options: Mapping[str, object]) -> None:
    """Nothing, for a source that is there and takes these options; it is not opened.

    Raises:
        InputError, SettingsError: as `open_source`.
    """
    _validated(source, source_options(source), options)


def open_source(source: str, options: Mapping[str, object]) -> Source:
    """The recording and truth of a catalog name, a folder, or NAME:FOLDER.

    Args:
        source: a folder is recognised by what lies in it.
        options: values, or text as a command line has it.

    Raises:
        InputError: unknown name, missing or unrecognised folder, or what the reader refuses.
        SettingsError: unknown option, or a value that it cannot take.
    """
    entry, place = _resolve(source)
    return entry.read(place, _validated(source, entry.options_class(), options))


def _resolve(source: str) -> tuple[_Entry, str]:
    """The entry and what its place is, as text."""
    entry = _ENTRIES.get(source)
    if entry is not None and not entry.needs_place:
        return entry, ""
    if _is_folder(Path(source)):
        return _recognised(source), source
    name, _, place = source.partition(":")
    if name not in _ENTRIES:
        meant = source if name == "course" else name
        raise InputError(
            f"{source!r}: expected a folder or a source, {known_names(meant, _ENTRIES)}"
        )
    if not place:
        raise InputError(f"{name}: expected its place too, as in {name}:FOLDER")
    return _ENTRIES[name], place


def _recognised(folder: str) -> _Entry:
    readers = {name: entry for name, entry in _ENTRIES.items() if entry.place in _FOLDER_PLACES}
    for entry in readers.values():
        if entry.recognises(Path(folder)):
            return entry
    raise InputError(
        f"{folder}: nothing in this folder is known; expected a recording of {', '.join(readers)}"
    )


def _is_folder(path: Path) -> bool:
    try:
        return path.is_dir()
    except OSError:
        return False


def _validated(
    source: str, options_class: type[BaseModel], options: Mapping[str, object]
) -> BaseModel:
    known = options_class.model_fields
    for name in options:
        if name not in known:
            raise SettingsError(f"{source}: unknown option {name!r}, {known_names(name, known)}")
    try:
        return options_class.model_validate(dict(options))
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        raise SettingsError(
            f"{source}: option {name}: {first['msg']}, got {first['input']!r}"
        ) from error
