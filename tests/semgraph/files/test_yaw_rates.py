"""Yaw rates come back from their file as they were; what is no table of them is refused."""

from pathlib import Path

import numpy as np
import pytest

from semgraph.errors import InputError, SemgraphError
from semgraph.files.yaw_rates import YawRateLog, YawRates, read_yaw_rates, write_yaw_rates


def test_what_is_written_is_read_exactly(tmp_path: Path) -> None:
    rng = np.random.default_rng(0)
    stamps_ns = 1_600_000_000_123_456_789 + np.cumsum(rng.integers(1, 10**8, 50))
    rates = YawRates(stamps_ns, rng.standard_normal(50))
    write_yaw_rates(tmp_path / "imu.csv", rates)
    again = read_yaw_rates(tmp_path / "imu.csv")
    np.testing.assert_array_equal(again.stamps_ns, rates.stamps_ns)
    np.testing.assert_array_equal(again.rates, rates.rates)


def test_none_are_read_as_none(tmp_path: Path) -> None:
    write_yaw_rates(tmp_path / "imu.csv", YawRates())
    assert len(read_yaw_rates(tmp_path / "imu.csv")) == 0


def test_a_log_keeps_the_first_of_each_time() -> None:
    log = YawRateLog()
    for stamp_ns, rate in ((1, 0.1), (2, 0.2), (2, 0.3), (1, 0.4), (3, 0.5)):
        log.add(stamp_ns, rate)
    rates = log.yaw_rates()
    assert rates.stamps_ns.tolist() == [1, 2, 3]
    assert rates.rates.tolist() == [0.1, 0.2, 0.5]
    assert len(YawRateLog().yaw_rates()) == 0


@pytest.mark.parametrize(
    "text",
    [
        "",
        "stamp_s,rate\n1,2\n",
        "stamp_s,yaw_rate_rad_s\n1\n",
        "stamp_s,yaw_rate_rad_s\n1,x\n",
        "stamp_s,yaw_rate_rad_s\n1,nan\n",
        "stamp_s,yaw_rate_rad_s\nx,1\n",
        "stamp_s,yaw_rate_rad_s\n1,0\n1,0\n",
    ],
)
def test_what_is_malformed_is_refused_by_name(tmp_path: Path, text: str) -> None:
    (tmp_path / "imu.csv").write_text(text)
    with pytest.raises(InputError, match=r"imu\.csv line"):
        read_yaw_rates(tmp_path / "imu.csv")


def test_disagreeing_arrays_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="yaw rates"):
        YawRates(np.array([1, 2]), np.zeros(3))
    with pytest.raises(InputError, match="increasing"):
        YawRates(np.array([2, 1]), np.zeros(2))
    with pytest.raises(SemgraphError, match="cannot be written"):
        write_yaw_rates(tmp_path / "nowhere" / "imu.csv", YawRates())
