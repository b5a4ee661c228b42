"""The arguments of `semgraph study`, and what is made of them."""

import argparse
import os
from pathlib import Path

from semgraph.command_line.argument_types import (
    DATA,
    AddParser,
    gibibytes,
    num_workers,
    positive,
    seeds,
)


def add_study(add_parser: AddParser) -> None:
    """The command and all its arguments."""
    study = add_parser(
        "study",
        help="estimators on the same data, many times; goes on where it was interrupted",
        epilog="studies that ship: paper, double-counting, odometry, clutter, range-and-density, "
        "scaling, real",
    )
    study.add_argument("study", metavar="STUDY", help="a file in TOML, or a name, see below")
    study.add_argument(
        "--output",
        type=Path,
        metavar="DIR",
        help="new, or of this study before (default: results/study-NAME)",
    )
    study.add_argument("--seeds", type=seeds, metavar="A-B", help="instead of the study's")
    study.add_argument(
        "--data",
        type=Path,
        default=DATA,
        metavar="DIR",
        help=f"the real recordings and stem maps (default: {DATA})",
    )
    study.add_argument(
        "--retry-failed", action="store_true", help="run those again that did not finish"
    )
    study.add_argument(
        "--trial", metavar="ID", help="run this one alone, write nothing; `--workers 0`: right here"
    )
    _add_execution(study)


def _add_execution(study: argparse.ArgumentParser) -> None:
    where = study.add_mutually_exclusive_group()
    where.add_argument(
        "--workers",
        type=num_workers,
        metavar="N",
        help="processes on this machine (default: its cores); 0: in this one, without limits",
    )
    where.add_argument(
        "--scheduler", metavar="ADDRESS", help="of an existing Dask cluster, as in tcp://HOST:8786"
    )
    for name, what in (
        ("ca", "authorities to trust"),
        ("cert", "certificate"),
        ("key", "private key"),
    ):
        study.add_argument(
            f"--tls-{name}",
            type=Path,
            metavar="PEM",
            help=f"{what}, for tls:// (default: as Dask is configured)",
        )
    study.add_argument(
        "--trial-timeout",
        type=positive,
        default=3600.0,
        metavar="S",
        help="end a trial that takes longer (default: 3600)",
    )
    study.add_argument(
        "--trial-memory",
        type=gibibytes,
        default=0.0,
        metavar="GIB",
        help="end a trial that takes more (default: as much as there is)",
    )


def call_study(parsed: argparse.Namespace) -> None:
    """Runs the study that was asked for.

    Raises:
        SemgraphError: anything that a user can put right.
    """
    from semgraph.one_thread import use_one_thread

    use_one_thread()
    from evaluation.studies.execution import Execution, Tls
    from evaluation.studies.trial_process import Limits
    from semgraph.command_line.study_command import StudyRequest, study
    from semgraph.errors import InputError

    tls = Tls(parsed.tls_ca, parsed.tls_cert, parsed.tls_key)
    if parsed.scheduler is None and tls != Tls():
        raise InputError("--tls-ca, --tls-cert, --tls-key: expected --scheduler with them")
    study(
        StudyRequest(
            parsed.study,
            parsed.output,
            parsed.seeds,
            parsed.data,
            parsed.retry_failed,
            parsed.trial,
            Execution(
                os.cpu_count() or 1 if parsed.workers is None else parsed.workers,
                parsed.scheduler,
                tls,
                Limits(parsed.trial_timeout, int(parsed.trial_memory * 2**30)),
            ),
        )
    )
