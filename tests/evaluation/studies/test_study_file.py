"""Studies in TOML: what they expand to, and what is refused."""

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from evaluation.studies.checks import check_trials
from evaluation.studies.study_file import (
    Condition,
    Study,
    parse_seeds,
    plan_study,
    read_study,
    shipped_studies,
    study_text,
)
from semgraph.errors import InputError

TEXT = """
name = "small"
question = "Which?"
seeds = "1-3"
estimators = ["fast", "oracle"]

[[condition]]
name = "course"
source = "course:perceptions"
options = { lap_s = 20, odometry = true }
settings = { "fast.search_radius_m" = 0.8 }
"""
GRID = """
[condition.grid]
clutter = [0, 1.5]
"smoother.closure_odds" = [10.0, 100.0, 1000.0]
"""
NOWHERE = Path("nowhere")


def read(folder: Path, text: str) -> Study:
    path = folder / "study.toml"
    path.write_text(text)
    return read_study(str(path))


def test_a_study_is_conditions_by_seeds_by_estimators(tmp_path: Path) -> None:
    trials = plan_study(read(tmp_path, TEXT), NOWHERE).trials
    assert [(each.seed, each.estimator) for each in trials] == [
        (seed, name) for seed in (1, 2, 3) for name in ("fast", "oracle")
    ]
    assert trials[0].options == (("lap_s", "20"), ("odometry", "true"))
    assert trials[0].settings == (("fast.search_radius_m", "0.8"),)
    check_trials(trials)


def test_a_grid_is_all_its_combinations_by_name(tmp_path: Path) -> None:
    trials = plan_study(read(tmp_path, TEXT + GRID), NOWHERE).trials
    assert len(trials) == 2 * 3 * 3 * 2
    assert trials[-1].condition == "course, clutter=1.5, closure_odds=1000.0"
    assert dict(trials[-1].options)["clutter"] == "1.5"
    assert dict(trials[-1].settings)["smoother.closure_odds"] == "1000.0"
    check_trials(trials)


def test_seeds_of_the_command_line_replace_the_studys(tmp_path: Path) -> None:
    own = TEXT + 'seeds = "5-7"\nestimators = ["oracle"]\n'
    assert {t.seed for t in plan_study(read(tmp_path, TEXT), NOWHERE, range(8, 10)).trials} == {
        8,
        9,
    }
    trials = plan_study(read(tmp_path, own), NOWHERE, range(8, 10)).trials
    assert [(each.seed, each.estimator) for each in trials] == [(5, "oracle"), (6, "oracle")]


def test_what_is_run_can_be_read_and_gives_the_same_trials(tmp_path: Path) -> None:
    plan = plan_study(read(tmp_path, TEXT + GRID), NOWHERE, range(4, 6))
    assert plan_study(read(tmp_path, study_text(plan.study)), NOWHERE).trials == plan.trials


def test_conditions_without_their_recording_are_left_out_with_a_word(tmp_path: Path) -> None:
    text = TEXT + '[[condition]]\nname = "real"\nsource = "car-park:{data}/car_park"\n'
    plan = plan_study(read(tmp_path, text), tmp_path)
    assert len(plan.trials) == 6
    assert plan.left_out == (f"real: left out, {tmp_path}/car_park is missing; see --data",)
    (tmp_path / "car_park").mkdir()
    assert plan_study(read(tmp_path, text), tmp_path).trials[-1].source == (
        f"car-park:{tmp_path}/car_park"
    )


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "name: Field required"),
        ("name = 3", "name: Input should be a valid string"),
        (TEXT.replace("small", "Two words"), "name"),
        (TEXT.replace("seeds", "seed"), "seed: unknown key, did you mean 'seeds'"),
        (TEXT.replace("options", "option"), "condition 0 option: unknown .* mean 'options'"),
        (TEXT.replace("1-3", "3-1"), "expected the smaller seed first, as in 1-100, got 3-1"),
        (TEXT.replace("1-3", "many"), "expected seeds as in 1-100, got 'many'"),
        (TEXT.replace("1-3", "1-99999"), "expected 1 to 10000 seeds"),
        (TEXT.replace('["fast", "oracle"]', "[]"), "estimators"),
        (TEXT.replace("lap_s", "seed"), "give seeds instead"),
        (TEXT.replace("lap_s", '"fast.x"'), "options fast.x"),
        (TEXT.replace("fast.search_radius_m", "search_radius_m"), "settings search_radius_m"),
        (TEXT.replace("20", "nan"), "options lap_s"),
        (TEXT.replace("20", "1979-05-27"), "options lap_s"),
        (TEXT + "more = 1", "more: unknown key"),
        (TEXT + "[condition.grid]\nclutter = []", "grid"),
        (TEXT + "[[condition]", "expected a study in TOML"),
        ("x" * 2**21, "at most 1048576 bytes"),
    ],
)
def test_what_is_no_study_is_refused(tmp_path: Path, text: str, reason: str) -> None:
    with pytest.raises(InputError, match=f"study.toml: .*{reason}"):
        read(tmp_path, text)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        (TEXT.replace('fast", ', 'fats", '), "unknown estimator 'fats', did you mean 'fast'"),
        (TEXT.replace("lap_s", "lap"), "condition 'course': .*unknown option 'lap'"),
        (TEXT.replace("= 20", "= -20"), "condition 'course': .*option lap_s"),
        (TEXT.replace("course:perceptions", "course:nowhere"), "expected a folder or a source"),
        (TEXT.replace("search_radius_m", "radius"), "unknown setting fast.radius"),
    ],
)
def test_what_would_fail_is_refused_before_anything_runs(
    tmp_path: Path, text: str, reason: str
) -> None:
    with pytest.raises(InputError, match=reason):
        check_trials(plan_study(read(tmp_path, text), NOWHERE).trials)


def test_two_conditions_of_one_name_are_refused(tmp_path: Path) -> None:
    twice = TEXT + TEXT[TEXT.index("[[condition]]") :]
    with pytest.raises(InputError, match="'course' with seed 1 and fast is there twice"):
        plan_study(read(tmp_path, twice), NOWHERE)


def test_an_unknown_study_is_answered_with_those_that_ship() -> None:
    with pytest.raises(InputError, match=r"papr: .*did you mean 'paper'\? known: .*scaling"):
        read_study("papr")


@pytest.mark.parametrize("name", shipped_studies())
def test_studies_that_ship_would_run(name: str, tmp_path: Path) -> None:
    study = read_study(name)
    assert study.name == name
    for place in ("car_park", "victoria_park", "mrclam6", "wild_v03", "stem_maps"):
        (tmp_path / place).mkdir()
    if name != "real":
        check_trials(plan_study(study, tmp_path, range(1, 3)).trials)


names = st.lists(st.sampled_from("abcdef"), min_size=1, max_size=3, unique=True)
values = st.lists(
    st.one_of(st.booleans(), st.integers(), st.floats(allow_nan=False, allow_infinity=False)),
    min_size=1,
    max_size=3,
    unique_by=repr,
)


@given(names, st.dictionaries(st.sampled_from(["x", "y", "fast.z"]), values), st.integers(1, 4))
def test_every_combination_is_there_once_with_an_id_of_its_own(
    estimators: list[str], grid: dict[str, list[bool | int | float]], num_seeds: int
) -> None:
    condition = Condition(name="c", source="s", grid=grid)
    study = Study(
        name="s",
        question="?",
        seeds=f"0-{num_seeds - 1}",
        estimators=estimators,
        condition=[condition],
    )
    trials = plan_study(study, NOWHERE).trials
    expected = num_seeds * len(estimators)
    for choices in grid.values():
        expected *= len(choices)
    assert len({each.id for each in trials}) == len(trials) == expected
    assert len({each.pair for each in trials}) == expected // len(estimators)


@given(st.integers(0, 10**8), st.integers(1, 10_000))
def test_seeds_are_what_they_say(first: int, number: int) -> None:
    assert parse_seeds(f"{first}-{first + number - 1}") == range(first, first + number)
