"""Studies in TOML: which estimators on which sources with which settings and seeds."""

import json
import re
import tomllib
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from itertools import product
from pathlib import Path
from typing import Annotated, Final, Self

import tomli_w
from pydantic import BaseModel, Field, ValidationError, model_validator

from evaluation.studies.trial import Trial
from semgraph.errors import InputError, known_names
from semgraph.files.json_files import STRICT, first_fault

DATA: Final = "{data}"
MAX_SEEDS: Final = 10_000
MAX_TRIALS: Final = 1_000_000
_MAX_BYTES: Final = 2**20

_Name = Annotated[str, Field(min_length=1, max_length=100, pattern=r"^[^\x00-\x1f]+$")]
_Scalar = bool | int | float | Annotated[str, Field(max_length=1000)]
_Value = _Scalar | list[_Scalar]
_Option = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*$")]
_Setting = Annotated[str, Field(pattern=r"^[A-Za-z_]\w*(\.[\w-]+)+$")]
_Grid = dict[_Option | _Setting, Annotated[list[_Value], Field(min_length=1, max_length=1000)]]


class Condition(BaseModel):
    """Measurements and settings that all estimators share.

    `grid` stands for as many conditions as its lists can be combined; a key with a dot is a
    setting, one without an option of the source. `seeds` and `estimators` replace the study's. In
    the source and in options `{data}` is the folder of the recordings.
    """

    model_config = STRICT

    name: _Name
    source: Annotated[str, Field(min_length=1, max_length=1000)]
    options: dict[_Option, _Value] = Field(default_factory=dict)
    settings: dict[_Setting, _Value] = Field(default_factory=dict)
    grid: _Grid = Field(default_factory=dict)
    seeds: str | None = None
    estimators: Annotated[list[_Name], Field(min_length=1)] | None = None

    @model_validator(mode="after")
    def _no_seed(self) -> Self:
        if "seed" in self.options or "seed" in self.grid:
            raise ValueError("the option seed is the trial's; give seeds instead")
        return self


class Study(BaseModel):
    """A study file."""

    model_config = STRICT

    name: Annotated[str, Field(max_length=100, pattern=r"^[a-z0-9][a-z0-9-]*$")]
    question: Annotated[str, Field(min_length=1, max_length=4000)]
    seeds: str
    estimators: Annotated[list[_Name], Field(min_length=1)]
    condition: Annotated[list[Condition], Field(min_length=1)]


@dataclass(frozen=True, slots=True)
class Plan:
    """A study with nothing left to choose.

    Attributes:
        study: as it is run: seeds and the folder of the data are in it.
        trials: in the order of conditions, seeds and estimators.
        left_out: conditions whose recording is missing, and why, one line each.
    """

    study: Study
    trials: tuple[Trial, ...]
    left_out: tuple[str, ...] = ()


def shipped_studies() -> tuple[str, ...]:
    """The names of the studies that come with the package."""
    folder = files("evaluation.studies").joinpath("shipped")
    return tuple(sorted(Path(each.name).stem for each in folder.iterdir() if _is_toml(each.name)))


def read_study(place: str) -> Study:
    """The study of a file, or the one of that name that comes with the package.

    Raises:
        InputError: there is none, or what is wrong with it.
    """
    path = Path(place)
    if place in shipped_studies():
        path = Path(str(files("evaluation.studies").joinpath("shipped", f"{place}.toml")))
    elif not path.is_file():
        raise InputError(
            f"{place}: expected a study's file or name, {known_names(place, shipped_studies())}"
        )
    return _parsed(path)


def study_text(study: Study) -> str:
    """A study as TOML."""
    return tomli_w.dumps(study.model_dump(exclude_none=True))


def plan_study(study: Study, data: Path, seeds: range | None = None) -> Plan:
    """The trials of a study.

    Args:
        study: as read.
        data: the folder of the recordings.
        seeds: instead of the study's; of a condition with seeds of its own as many as these.

    Raises:
        InputError: two trials are alike, there are none or too many, or seeds are none.
    """
    conditions, left_out = [], []
    for condition in study.condition:
        missing = _missing(condition, data)
        if missing is None:
            conditions.append(_settled(condition, data, seeds))
        else:
            left_out.append(f"{condition.name}: left out, {missing} is missing; see --data")
    if not conditions:
        raise InputError(f"study {study.name}: nothing to run; {'; '.join(left_out)}")
    chosen = study.seeds if seeds is None else _seeds_text(seeds)
    effective = study.model_copy(update={"seeds": chosen, "condition": conditions})
    trials = tuple(_trials(effective))
    _check_trials(study, trials)
    return Plan(effective, trials, tuple(left_out))


def parse_seeds(text: str) -> range:
    """A-B, or A alone.

    Raises:
        InputError: neither, or more than `MAX_SEEDS`.
    """
    match = re.fullmatch(r"([0-9]{1,9})(?:-([0-9]{1,9}))?", text)
    if match is None:
        raise InputError(f"expected seeds as in 1-100, got {text[:40]!r}")
    seeds = range(int(match[1]), int(match[2] or match[1]) + 1)
    if not seeds:
        raise InputError(f"expected the smaller seed first, as in 1-100, got {text}")
    if len(seeds) > MAX_SEEDS:
        raise InputError(f"expected 1 to {MAX_SEEDS} seeds, got {text}")
    return seeds


def _is_toml(name: str) -> bool:
    return name.endswith(".toml")


def _parsed(path: Path) -> Study:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise InputError(f"{path}: expected a study of at most {_MAX_BYTES} bytes")
        study = Study.model_validate(tomllib.loads(path.read_text(encoding="utf-8")))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise InputError(f"{path}: expected a study in TOML: {error}") from error
    except ValidationError as error:
        raise InputError(f"{path}: {_unknown_key(error) or first_fault(error)}") from error
    for text in (study.seeds, *(each.seeds for each in study.condition)):
        _check_seeds(path, text)
    return study


def _unknown_key(error: ValidationError) -> str | None:
    """What to write instead of the first unknown key; a key that is missing may be that one."""
    for fault in error.errors(include_url=False, include_context=False, include_input=False):
        if fault["type"] == "extra_forbidden":
            *place, key = map(str, fault["loc"])
            names = (Condition if place else Study).model_fields
            return f"{' '.join([*place, key])}: unknown key, {known_names(key, names)}"
    return None


def _check_seeds(path: Path, text: str | None) -> None:
    try:
        if text is not None:
            parse_seeds(text)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def _seeds_text(seeds: range) -> str:
    return f"{seeds[0]}-{seeds[-1]}"


def _missing(condition: Condition, data: Path) -> str | None:
    """The file or folder of the data that a condition needs and that is not there."""
    for text in (condition.source, *map(_text, condition.options.values())):
        if DATA in text:
            place = text[text.index(DATA) :].replace(DATA, str(data.resolve()))
            if not Path(place).exists():
                return place
    return None


def _settled(condition: Condition, data: Path, seeds: range | None) -> Condition:
    """With the data's folder in place, and not more seeds than asked for."""
    folder = str(data.resolve())
    options = {
        key: value.replace(DATA, folder) if isinstance(value, str) else value
        for key, value in condition.options.items()
    }
    own = condition.seeds
    if own is not None and seeds is not None:
        own = _seeds_text(parse_seeds(own)[: len(seeds)])
    source = condition.source.replace(DATA, folder)
    return condition.model_copy(update={"source": source, "options": options, "seeds": own})


def _trials(study: Study) -> Iterator[Trial]:
    for condition in study.condition:
        for name, options, settings in _expanded(condition):
            for seed in parse_seeds(condition.seeds or study.seeds):
                for estimator in condition.estimators or study.estimators:
                    yield Trial(
                        study.name, name, condition.source, options, settings, estimator, seed
                    )


_Texts = tuple[tuple[str, str], ...]


def _expanded(condition: Condition) -> Iterator[tuple[str, _Texts, _Texts]]:
    """Name, options and settings of each condition that one with a grid stands for."""
    for values in product(*condition.grid.values()):
        chosen = dict(zip(condition.grid, values, strict=True))
        words = [f"{key.rpartition('.')[2]}={_text(value)}" for key, value in chosen.items()]
        options = {key: value for key, value in chosen.items() if "." not in key}
        settings = {key: value for key, value in chosen.items() if "." in key}
        yield (
            ", ".join([condition.name, *words]),
            _texts({**condition.options, **options}),
            _texts({**condition.settings, **settings}),
        )


def _texts(values: Mapping[str, _Value]) -> _Texts:
    return tuple((key, _text(value)) for key, value in sorted(values.items()))


def _text(value: _Value) -> str:
    """As a command line has it after `--set key=`."""
    if isinstance(value, str):
        return value
    return json.dumps(value) if isinstance(value, bool | list) else repr(value)


def _check_trials(study: Study, trials: tuple[Trial, ...]) -> None:
    if len(trials) > MAX_TRIALS:
        raise InputError(f"study {study.name}: expected at most {MAX_TRIALS} trials")
    alike: dict[tuple[str, int, str], Trial] = {}
    for trial in trials:
        twin = alike.setdefault((*trial.pair, trial.estimator), trial)
        if twin is not trial:
            raise InputError(
                f"study {study.name}: condition {trial.condition!r} with seed {trial.seed} and "
                f"{trial.estimator} is there twice; give each condition a name of its own"
            )
