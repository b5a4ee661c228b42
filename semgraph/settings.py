"""All settings of a run: defaults that work < file < flags; unknown names are refused."""

import tomllib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from semgraph.beside.online import OnlineSettings
from semgraph.errors import InputError, SettingsError, known_names
from semgraph.fast_estimator import FastSettings
from semgraph.graph.smoother import SmootherSettings
from semgraph.localizer import LocalizerSettings
from sensors.files import read_text

_MOST_BYTES: Final = 2**20


class TrackerSettings(FastSettings):
    """Settings of the tracker that feeds the graph: a fast estimator with a short memory.

    `hypotheses` of all associations are followed at once where scans show few things that are
    alike, at a cost a scan that grows with them; 1 is the fast estimator itself, None as many as
    the recording asks for. `seed` is of their random numbers. They are followed `tries` times, each
    with random numbers of its own, and the most probable outcome is kept.
    """

    memory_m: float = Field(20.0, gt=0.0)
    hypotheses: int | None = Field(None, ge=1, le=100_000)
    seed: int = Field(0, ge=0)
    tries: int = Field(4, ge=1, le=100)


class Settings(BaseModel):
    """The sections of a settings file.

    `source` holds the options of the source, `detectors` the settings of each detector by its name
    (false leaves out one of the source's), `filters` what is done to scans before (None: what the
    source asks for). They are checked where they are used.
    """

    model_config = ConfigDict(frozen=True, extra="forbid")

    source: dict[str, Any] = Field(default_factory=dict)
    filters: list[dict[str, Any]] | None = None
    detectors: dict[str, dict[str, Any] | Literal[False]] = Field(default_factory=dict)
    fast: FastSettings = FastSettings()
    tracker: TrackerSettings = TrackerSettings()
    smoother: SmootherSettings = SmootherSettings()
    localizer: LocalizerSettings = LocalizerSettings()
    online: OnlineSettings = OnlineSettings()


def load_settings(file: Path | None, assignments: Sequence[str]) -> Settings:
    """The effective settings of a TOML file and `key=value` flags.

    Args:
        file: sections as in `Settings`, or None.
        assignments: `fast.search_radius_m=0.8`; a key without a section belongs to the source.

    Raises:
        SettingsError: the file cannot be read, or a name or value is not known.
    """
    tables = _read(file) if file is not None else {}
    for assignment in assignments:
        key, separator, value = assignment.partition("=")
        if not separator or not key:
            raise SettingsError(f"--set {assignment}: expected key=value")
        *sections, name = key.split(".") if "." in key else _place(key)
        table = tables
        for section in sections:
            table = table.setdefault(section, {})
            if not isinstance(table, dict):
                raise SettingsError(f"--set {assignment}: {section} is no section")
        table[name] = _value(assignment, value)
    return _validated(tables, str(file) if file is not None else "--set")


def _place(key: str) -> tuple[str, ...]:
    """A key without a section is the source's, but for the list of filters."""
    return (key,) if key == "filters" else ("source", key)


def _value(assignment: str, text: str) -> object:
    """Lists, tables and truth values as TOML has them; the rest is read by who takes it."""
    if not text.startswith(("[", "{")) and text not in ("true", "false"):
        return text
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError) as error:
        reason = str(error).partition("\n")[0]
        raise SettingsError(f"--set {assignment[:80]}: expected TOML: {reason}") from error


def _read(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(read_text(file, _MOST_BYTES))
    except InputError as error:
        raise SettingsError(str(error)) from error
    except (ValueError, RecursionError) as error:
        reason = str(error).partition("\n")[0]
        raise SettingsError(f"{file}: expected a TOML file: {reason}") from error


def _validated(tables: Mapping[str, Any], where: str) -> Settings:
    try:
        return Settings.model_validate(tables)
    except ValidationError as error:
        first = error.errors()[0]
        path = [str(part) for part in first["loc"]]
        if first["type"] == "extra_forbidden":
            known = _known(path[:-1])
            raise SettingsError(
                f"{where}: unknown setting {'.'.join(path)}, {known_names(path[-1], known)}"
            ) from error
        raise SettingsError(
            f"{where}: {'.'.join(path)}: {first['msg']}, got {first['input']!r}"
        ) from error


def _known(sections: Sequence[str]) -> list[str]:
    """The names that a section, or the file, may hold."""
    model: type[BaseModel] = Settings
    for section in sections:
        annotation = model.model_fields[section].annotation
        if not (isinstance(annotation, type) and issubclass(annotation, BaseModel)):
            return []
        model = annotation
    return list(model.model_fields)
