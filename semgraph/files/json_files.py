"""JSON files read against a schema, refused by file, place and reason."""

from pathlib import Path
from typing import TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from semgraph.errors import InputError
from semgraph.files.tables import read_text

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)

Schema = TypeVar("Schema", bound=BaseModel)


def read_json(path: Path, schema: type[Schema]) -> Schema:
    """A JSON file as its schema.

    Raises:
        InputError: no JSON, or not of the schema.
    """
    try:
        return schema.model_validate_json(read_text(path))
    except ValidationError as error:
        raise InputError(f"{path}: {first_fault(error)}") from error


def first_fault(error: ValidationError) -> str:
    """Where and why a schema was not kept, in one line."""
    first = error.errors(include_url=False, include_context=False, include_input=False)[0]
    place = " ".join(str(part) for part in first["loc"])
    return f"{place or 'file'}: {first['msg']}"
