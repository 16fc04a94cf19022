"""`bp2 export`: copy a policy to a folder, or write the bundle that runs on a robot,
or a web page."""

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
    """Copy a policy to a folder, or write a bundle that runs it on a robot's computer
    or on a web page.

    With --report, the copy's card has the results of an evaluation: run eval.py on the
    policy first.

    For example: bp2 export built --to my_robot --format onnx
    """

    run: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN_OR_POLICY")]
    """Name of a shipped policy, or folder of a policy or a training run."""
    to: Annotated[Path, tyro.conf.arg(metavar="DIR")]
    """Folder to write; a policy or a bundle in this folder is replaced."""
    format: Literal["policy", "onnx", "page"] = "policy"
    """policy: a copy, with its card. onnx: a bundle that runs without JAX: the network,
    the reference motion, a controller in Python and in C++, and a rehearsal in C MuJoCo
    (docs/deploy.md). page: a folder for a file server, whose page runs the policy in a
    browser"""
    report: Annotated[
        tyro.conf.UseAppendAction[tuple[Path, ...]], tyro.conf.arg(metavar="REPORT_DIR")
    ] = ()
    """Folder of a report that eval.py wrote for this policy; can be given several
    times. Not with onnx or page, which have no card."""
    task: TaskFlag = None
    """The policy's task, if the task adds observations; a bundle holds their code"""
    terrain: TerrainFlag = "flat"
    mujoco_package: Annotated[Path | None, tyro.conf.arg(metavar="FILE")] = None
    """The .tgz of npm's @mujoco/mujoco for --format page, on a machine without a
    network"""
    braking: float | None = None
    """greatest deceleration of the forward command, m/s2 (`control.braking` of the
    copy)"""
    stopping_time: float | None = None
    """least time in which the forward command c falls by c + 0.5 m/s, s
    (`control.stopping_time` of the copy)"""
    launching: float | None = None
    """greatest acceleration of the forward command at a stand, m/s2
    (`control.launching` of the copy)"""
    launching_speed: float | None = None
    """forward command at which that limit on the acceleration has fallen to 0, m/s
    (`control.launching_speed` of the copy)"""


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
            "--terrain belongs to a bundle's rehearsal or a page: give --format onnx or page, too"
        )
    if config.format != "page" and config.mujoco_package:
        raise UserError("--mujoco-package belongs to a page: give --format page, too")
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
    # checks the new limits
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
        # Results under the old limits do not hold for the copy; the judge's result is
        # kept as an estimate.
        results = {
            name: found
            for name, found in policy.card.results.items()
            if not eased or name == "judged"
        }
        for folder in config.report:
            report = read_report(folder)
            weights = policy.card.weights_sha256
            measured = report.conditions.get("weights_sha256", "")
            if measured != weights:
                raise UserError(
                    f"report {folder} is of another policy: its weights are {measured[:12] or 'unknown'}, those of "
                    f"{config.run} are {weights[:12]}; make a new report: python eval.py {config.run} --out DIR"
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
