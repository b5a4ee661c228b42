"""Absolute and relative errors are those of the commands of evo 1.38, where they are installed."""

import json
import os
import shutil
import subprocess
import zipfile
from pathlib import Path

import numpy as np
import pytest

from evaluation.alignment import Alignment
from evaluation.trajectory import compare_path, frame_errors, rmse
from semgraph.estimates import Trajectory
from semgraph.files.trajectory_files import write_tum
from sensors.truth import TruePath
from tests.evaluation.course import make_run

pytestmark = pytest.mark.skipif(
    shutil.which("evo_ape") is None or shutil.which("evo_rpe") is None,
    reason="needs the commands evo_ape and evo_rpe (evo)",
)
AS_EVO = {Alignment.RIGID: ["--align"], Alignment.ORIGIN: ["--align_origin"], Alignment.NONE: []}


def drawn(seed: int) -> tuple[Trajectory, TruePath]:
    result, truth = make_run(seed, sigma_m=0.02 * (1 + seed))
    assert truth.path is not None
    return result.fast, truth.path


def by_evo(folder: Path, command: str, *arguments: str) -> float:
    """The RMSE, with all its digits."""
    result = folder / "result.zip"
    told = ("--save_results", str(result), "--no_warnings", "--silent")
    subprocess.run(
        [command, "tum", "truth.tum", "estimate.tum", *arguments, *told],
        cwd=folder,
        env={**os.environ, "HOME": str(folder)},
        capture_output=True,
        check=True,
    )
    with zipfile.ZipFile(result) as archive:
        return float(json.loads(archive.read("stats.json"))["rmse"])


def written(folder: Path, estimate: Trajectory, path: TruePath) -> None:
    assert path.headings is not None
    true = np.column_stack([path.world_t_reference, path.headings])
    write_tum(folder / "truth.tum", Trajectory(path.stamps_ns, true))
    write_tum(folder / "estimate.tum", estimate)


@pytest.mark.parametrize("seed", range(20))
def test_both_errors(tmp_path: Path, seed: int) -> None:
    estimate, path = drawn(seed)
    written(tmp_path, estimate, path)
    absolute, relative = compare_path(estimate, path), frame_errors(estimate, path)
    assert absolute is not None
    assert relative is not None
    assert rmse(absolute.errors) == pytest.approx(by_evo(tmp_path, "evo_ape", "--align"), abs=1e-6)
    assert relative.translation_rmse_m == pytest.approx(by_evo(tmp_path, "evo_rpe"), abs=1e-6)


@pytest.mark.parametrize("alignment", Alignment)
def test_each_alignment(tmp_path: Path, alignment: Alignment) -> None:
    estimate, path = drawn(3)
    written(tmp_path, estimate, path)
    errors = compare_path(estimate, path, alignment)
    assert errors is not None
    evo_m = by_evo(tmp_path, "evo_ape", *AS_EVO[alignment])
    assert rmse(errors.errors) == pytest.approx(evo_m, abs=1e-6)


@pytest.mark.parametrize("frames", [1, 7])
def test_turns_over_frames(tmp_path: Path, frames: int) -> None:
    estimate, path = drawn(4)
    written(tmp_path, estimate, path)
    relative = frame_errors(estimate, path, frames)
    assert relative is not None
    evo_deg = by_evo(tmp_path, "evo_rpe", "--delta", str(frames), "-r", "angle_deg")
    assert np.degrees(relative.heading_rmse) == pytest.approx(evo_deg, abs=1e-6)
