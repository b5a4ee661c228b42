"""The batch optimum with true associations."""

from dataclasses import replace

import numpy as np
import pytest

from evaluation.oracle import oracle
from evaluation.trajectory import compare_path, rmse
from semgraph.errors import InputError
from semgraph.perceiving import Perceiver
from semgraph.pipeline import run
from semgraph.progress import Silence
from semgraph.settings import Settings
from sensors.catalog import open_source
from sensors.truth import Source, Truth

SHORT = {"num_trees": 40, "lap_s": 20.0, "overlap_s": 3.0, "scan_rate_hz": 5.0, "clutter": 0.5}


def course(seed: int) -> Source:
    return open_source("course:perceptions", {"seed": seed, "track_radius_m": 10.0, **SHORT})


@pytest.mark.parametrize("seed", [1, 2])
def test_the_smoother_comes_near_and_places_show_its_covariance(seed: int) -> None:
    source = course(seed)
    best = oracle(source, Settings())
    settings = Settings()
    result = run(source.recording, settings, Perceiver(source.recording, settings), Silence(), {})
    path, true = source.truth.path, source.truth.landmarks
    assert path is not None
    assert true is not None
    oracle_errors, smoothed_errors = (
        compare_path(each, path) for each in (best.trajectory, result.smoothed)
    )
    assert oracle_errors is not None
    assert smoothed_errors is not None
    assert rmse(oracle_errors.distances) < 0.03
    assert rmse(smoothed_errors.distances) < 1.3 * rmse(oracle_errors.distances)
    assert best.covariances.shape == (len(best.trajectory), 3, 3)
    for row, place in best.map_t_landmarks.items():
        error = oracle_errors.world_T_map.transform(place[None])[0] - true.world_t_landmarks[row]
        assert np.linalg.norm(error) < 0.15


def test_without_associations_the_nearest_true_landmark_is_taken() -> None:
    source = course(3)
    known = oracle(source, Settings())
    guessed = oracle(Source(source.recording, replace(source.truth, associations=None)), Settings())
    np.testing.assert_allclose(
        guessed.trajectory.map_T_bases, known.trajectory.map_T_bases, atol=0.02
    )


def test_without_truth_there_is_none() -> None:
    source = course(3)
    with pytest.raises(InputError, match="true poses and landmarks"):
        oracle(Source(source.recording, Truth()), Settings())
