"""What the graph's process tells of its work."""

from contextlib import closing

from semgraph.beside.smoothing_loop import Doing, Taken, _Teller
from semgraph.beside.spool import Spool
from semgraph.geometry import Pose2


def test_the_last_scan_is_told_before_what_is_done_in_the_end() -> None:
    """Else the run believes that the graph is still behind, and has less patience with it."""
    with closing(Spool()) as answers:
        teller = _Teller(answers)
        for scan in range(5):
            teller.took(Taken(scan, Pose2(), Pose2()))
        teller.doing("settling")
        told = list(iter(answers.read, None))
    assert told[-2:] == [Taken(4, Pose2(), Pose2()), Doing("settling")]
