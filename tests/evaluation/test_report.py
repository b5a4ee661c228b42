import json
import subprocess
import sys
from pathlib import Path

import pytest

from evaluation.metrics import Direction, Metric, judge
from evaluation.report import evaluate_folder, read_metrics, table_rows, write_metrics
from evaluation.truth_files import write_truth
from semgraph import results
from semgraph.errors import InputError
from tests.evaluation.course import make_run, with_imu

METRICS = (
    Metric("trajectory_rmse_m", 0.1 + 0.2, "m", Direction.LOWER),
    Metric("landmarks_found", 15.0, "", Direction.HIGHER),
    Metric("nees_mean", 3.25, "", Direction.EXPECTED, 3.0),
    Metric("scans_per_second", 1234.5, "1/s", Direction.HIGHER),
    Metric("num_loop_closures", 2.0, "", Direction.NEITHER),
    Metric("yaw_rate_rms_rad_s", 0.012, "rad/s", Direction.LOWER),
)


def test_metrics_are_read_again_exactly(tmp_path: Path) -> None:
    write_metrics(tmp_path, METRICS)
    assert read_metrics(tmp_path) == METRICS
    entry = json.loads((tmp_path / "metrics.json").read_text())["trajectory_rmse_m"]
    assert entry == {"value": 0.1 + 0.2, "unit": "m", "better": "lower"}


def test_the_table_reads_well() -> None:
    assert table_rows(METRICS) == [
        ("trajectory rmse", "0.300", "m", "lower is better"),
        ("landmarks found", "15", "", "higher is better"),
        ("nees mean", "3.250", "", "expected 3"),
        ("scans per second", "1234.5", "1/s", "higher is better"),
        ("num loop closures", "2", "", ""),
        ("yaw rate rms", "0.012", "rad/s", "lower is better"),
    ]


def test_a_run_is_judged_again_from_its_files_alone(tmp_path: Path) -> None:
    result, truth = make_run(0)
    with results.staged_results(tmp_path / "run") as staging:
        results.write_files(result, staging)
        write_truth(staging, truth)
    metrics = evaluate_folder(tmp_path / "run")
    assert read_metrics(tmp_path / "run") == metrics
    for again, before in zip(metrics, judge(result, truth), strict=True):
        assert again.name == before.name
        assert again.value == pytest.approx(before.value, rel=1e-9, abs=1e-12)
    for picture in ("map.png", "errors.png"):
        assert (tmp_path / "run" / picture).read_bytes().startswith(b"\x89PNG")


def test_a_folder_without_a_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"run\.json: expected a file"):
        evaluate_folder(tmp_path)


@pytest.mark.parametrize(
    ("text", "reason"),
    [
        ("", "file"),
        ("[]", "file"),
        ('{"a": {"value": 1, "unit": "m"}}', "a better"),
        ('{"a": {"value": "1", "unit": "m", "better": "lower"}}', "a value"),
        ('{"a": {"value": NaN, "unit": "m", "better": "lower"}}', "a value"),
        ('{"a": {"value": 1, "unit": "m", "better": "more"}}', "'more' is not a valid Direction"),
    ],
)
def test_spoilt_metrics_are_refused(tmp_path: Path, text: str, reason: str) -> None:
    (tmp_path / "metrics.json").write_text(text)
    with pytest.raises(InputError, match=reason) as caught:
        read_metrics(tmp_path)
    assert "metrics.json" in str(caught.value)


def test_nothing_heavy_is_imported_before_it_is_used() -> None:
    code = "import evaluation.report, evaluation.figures, sys; print(*sys.modules)"
    names = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert "evaluation.report" in names.stdout.split()
    assert not {"matplotlib", "scipy", "gtsam", "rerun"} & set(names.stdout.split())


def test_rotation_is_judged_and_drawn_again_where_an_imu_measured(tmp_path: Path) -> None:
    result, truth = make_run(1)
    assert truth.path is not None
    names = {}
    for folder, shown in (("with", with_imu(result, truth.path)), ("without", result)):
        results.write(shown, tmp_path / folder)
        write_truth(tmp_path / folder, truth)
        evaluate_folder(tmp_path / folder)
        again = evaluate_folder(tmp_path / folder)
        assert (tmp_path / folder / "rotation.png").exists() is (folder == "with")
        assert (tmp_path / folder / "imu.csv").exists() is (folder == "with")
        names[folder] = {metric.name: metric for metric in again}
    rms = {f"{prefix}yaw_rate_rms_rad_s" for prefix in ("", "fast_")}
    assert names["with"].keys() - names["without"].keys() == rms
    smoothed = names["with"]["yaw_rate_rms_rad_s"]
    assert (smoothed.unit, smoothed.better) == ("rad/s", Direction.LOWER)
    assert 0.0 < smoothed.value < names["with"]["fast_yaw_rate_rms_rad_s"].value
