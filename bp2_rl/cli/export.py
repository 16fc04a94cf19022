"""`bp2 export`: copy a run's policy to a folder of its own, or write the bundle that
runs on a robot."""

import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from bp2_rl.base.errors import UserError
from bp2_rl.cli.app import Command
from bp2_rl.learning.policy import find_policy
from bp2_rl.robot.operator import COMMAND_LIMITS
from bp2_rl.settings.terrain import Terrain, TerrainFlag
from bp2_rl.settings.training import TaskFlag

if TYPE_CHECKING:
    from bp2_rl.learning.policy import Policy


@dataclasses.dataclass(frozen=True)
class ExportConfig:
    """Copy a run's policy to a folder of its own, to keep it or to pass it on, or write
    what a robot's computer needs.

    With reports, the copy's card says what was measured: run eval.py on the policy
    first.

    For example: bp2 export built --to my_robot --format onnx
    """

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_POLICY")]
    """A training run's folder or a policy folder."""
    to: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """The copy's folder; a policy or a bundle that is there is replaced."""
    format: Literal["policy", "onnx", "page"] = "policy"
    """policy: a copy, with its card. onnx: a bundle that runs without JAX: the network,
    the reference motion, a controller in Python and in C++, and a rehearsal in C MuJoCo
    (docs/deploy.md). page: a folder for a file server, whose page runs the policy in a
    browser"""
    report: Annotated[
        tyro.conf.UseAppendAction[tuple[Path, ...]], tyro.conf.arg(metavar="REPORT_DIR")
    ] = ()
    """A folder that eval.py wrote of this policy; may be given several times. Not with
    onnx or page, which have no card."""
    task: TaskFlag = None
    """The task that the policy was trained with, where the task adds to what the policy
    sees: a bundle holds its observations' code"""
    terrain: TerrainFlag = "flat"
    mujoco_package: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """The .tgz of npm's @mujoco/mujoco for --format page, where there is no network
    from which to fetch it"""
    braking: float | None = None
    """m/s2, at which the forward command that the policy is told falls at most: the
    copy's `control.braking`"""
    stopping_time: float | None = None
    """s, in which it falls by itself and 0.5 m/s, at most: the copy's
    `control.stopping_time`"""
    launching: float | None = None
    """m/s2, at which it rises at most from a stand: the copy's `control.launching`"""
    launching_speed: float | None = None
    """m/s, at which it would rise no more: the copy's `control.launching_speed`"""


def export(config: ExportConfig) -> None:
    """Copy a policy or write its bundle, as `config` says; check all inputs before
    writing."""
    if config.format != "policy" and config.report:
        raise UserError(
            "--report adds to a policy's card, and only a copy has one: leave out --report or "
            f"--format {config.format}"
        )
    if config.format == "policy" and config.terrain != "flat":
        raise UserError(
            "--terrain is of a bundle's rehearsal or a page: give --format onnx or page, too"
        )
    if config.format != "page" and config.mujoco_package:
        raise UserError("--mujoco-package is of a page: give --format page, too")
    eased = {
        name: value
        for name in COMMAND_LIMITS
        if (value := getattr(config, name)) is not None
    }
    if eased and config.report:
        raise UserError(
            f"--report was measured without --{next(iter(eased)).replace('_', '-')}: export the copy without "
            "--report, run eval.py on it, and export it again with the new report"
        )
    find_policy(config.run)
    # Imported here so that --help and a mistyped flag are answered at once.
    from bp2_rl.cli import runtime  # noqa: F401  # isort: skip  # before all that imports MuJoCo

    from bp2_rl.evaluation.report.folder import read_report
    from bp2_rl.learning.policy import load_policy, save_policy
    from bp2_rl.simulation.world import World

    policy = load_policy(config.run, task=config.task)
    env = policy.card.env
    # refuses what cannot be
    env = dataclasses.replace(env, control=dataclasses.replace(env.control, **eased))
    policy = dataclasses.replace(policy, card=dataclasses.replace(policy.card, env=env))
    world = World(Terrain.of(config.terrain))
    if config.format == "page":
        from bp2_rl.deploy.page.folder import write_page

        write_page(config.to, policy, world, config.mujoco_package)
        lines = [f"see it: python -m http.server --directory {config.to}"]
    elif config.format == "onnx":
        from bp2_rl.deploy.bundle import write_bundle

        write_bundle(config.to, policy, world)
        lines = _advice(config, policy)
    else:
        # under other limits another controller was measured; what the judge saw is kept
        # as a guess
        results = {
            name: found
            for name, found in policy.card.results.items()
            if not eased or name == "judged"
        }
        for folder in config.report:
            report = read_report(folder)
            ours = policy.card.weights_sha256
            theirs = report.conditions.get("weights_sha256", "")
            if theirs != ours:
                raise UserError(
                    f"report {folder} is of another policy: weights {theirs[:12] or 'unknown'}, those of "
                    f"{config.run} are {ours[:12]}; make one: python eval.py {config.run} --out DIR"
                )
            results = results | report.results
        card = dataclasses.replace(policy.card, results=results)
        save_policy(config.to, dataclasses.replace(policy, card=card))
        again = f"python eval.py {config.to} --benchmark all --out DIR"
        lines = [f"its card has no results yet: {again}"] if eased else []
    print(f"exported {config.run} to {config.to}", *lines, sep="\n")


def _advice(config: ExportConfig, policy: "Policy") -> Iterator[str]:
    """Yield what is to be known of a bundle, and the line that tries it."""
    if policy.card.stage == "imitation":
        yield "it may fall where measurements are lost, as in the rehearsal: the relaxed stage trains for that"
    if own := [name for name, _ in policy.card.env.task.observations]:
        yield f"cpp/ refuses {', '.join(own)}: the task's observations are Python"
    yield f"try it: cd {config.to} && pip install -r requirements.txt && python -m onboard.rehearse"


main = Command("bp2 export", ExportConfig, export)
