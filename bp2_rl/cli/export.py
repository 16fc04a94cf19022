"""`bp2 export`: copy a run's policy to a folder of its own, with what was measured of it on its card."""

import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import tyro

from bp2_rl.cli import app
from bp2_rl.errors import UserError


@dataclasses.dataclass(frozen=True)
class ExportConfig:
    """Copy a run's policy to a folder of its own, to keep it or to pass it on.

    With a report, the copy's card says what was measured: run eval.py on the policy first.
    """

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_POLICY")]
    """A training run's folder or a policy folder."""
    to: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """The copy's folder; a policy that is there is replaced."""
    report: Annotated[Path | None, tyro.conf.arg(metavar="REPORT_DIR")] = None
    """A folder that eval.py wrote of this policy."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: export(app.parse(ExportConfig, argv, "bp2 export")))


def export(config: ExportConfig) -> None:
    """Export as configured; nothing is written before everything has been read and fits together."""
    # MuJoCo binds this library when imported and fails if it is not there; nothing is drawn here.
    os.environ.pop("MUJOCO_GL", None)
    # Imported here for that reason, and so that --help and a mistyped flag are answered at once.
    from bp2_rl.cli import runtime  # noqa: F401  # isort: skip

    from bp2_rl.evaluation.report import read_report, results
    from bp2_rl.learning.policy import load_policy, save_policy

    policy = load_policy(config.run)
    if config.report is not None:
        report = read_report(config.report)
        ours, theirs = policy.card.weights_sha256, report.conditions.get("weights_sha256", "")
        if theirs != ours:
            raise UserError(
                f"report {config.report} is of another policy: weights {theirs[:12] or 'unknown'}, those of "
                f"{config.run} are {ours[:12]}; make one: python eval.py {config.run} --out DIR"
            )
        card = dataclasses.replace(policy.card, results=policy.card.results | results(report))
        policy = dataclasses.replace(policy, card=card)
    save_policy(config.to, policy)
    print(f"exported {config.run} to {config.to}")
