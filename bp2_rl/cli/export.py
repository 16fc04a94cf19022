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

    With reports, the copy's card says what was measured: run eval.py on the policy first.
    """

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_POLICY")]
    """A training run's folder or a policy folder."""
    to: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """The copy's folder; a policy that is there is replaced."""
    report: Annotated[tyro.conf.UseAppendAction[tuple[Path, ...]], tyro.conf.arg(metavar="REPORT_DIR")] = ()
    """A folder that eval.py wrote of this policy; may be given several times."""


def main(argv: Sequence[str] | None = None) -> int:
    """The command; returns its exit status."""
    return app.run(lambda: export(app.parse(ExportConfig, argv, "bp2 export")))


def export(config: ExportConfig) -> None:
    """Export as configured; nothing is written before everything has been read and fits together."""
    # MuJoCo binds this library when imported and fails if it is not there; nothing is drawn here.
    os.environ.pop("MUJOCO_GL", None)
    # Imported here for that reason, and so that --help and a mistyped flag are answered at once.
    from bp2_rl.cli import runtime  # noqa: F401  # isort: skip

    from bp2_rl.evaluation.report.folder import read_report
    from bp2_rl.learning.policy import load_policy, save_policy

    policy = load_policy(config.run)
    results = policy.card.results
    for folder in config.report:
        report = read_report(folder)
        ours, theirs = policy.card.weights_sha256, report.conditions.get("weights_sha256", "")
        if theirs != ours:
            raise UserError(
                f"report {folder} is of another policy: weights {theirs[:12] or 'unknown'}, those of "
                f"{config.run} are {ours[:12]}; make one: python eval.py {config.run} --out DIR"
            )
        results = results | report.results
    policy = dataclasses.replace(policy, card=dataclasses.replace(policy.card, results=results))
    save_policy(config.to, policy)
    print(f"exported {config.run} to {config.to}")
