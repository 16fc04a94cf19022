"""Search for settings of faster policies with Optuna.

    pip install -c constraints.txt -e ".[tune]"
    python examples/tune.py             # one training after the other, here
    pip install -c constraints.txt -e ".[cluster]"
    python examples/tune.py slurm       # each training a job of a cluster

The results are kept in runs/tune/tune.db: called again, the search continues.
"""

import dataclasses
import multiprocessing
import sys
from concurrent.futures import Executor, ProcessPoolExecutor
from pathlib import Path
from typing import TYPE_CHECKING

import bp2_rl as bp2
from bp2_rl.settings.training import TrainConfig
from bp2_rl.tools.study.outcome import measure_policies

if TYPE_CHECKING:
    import submitit
    from optuna.trial import FixedTrial, FrozenTrial, Trial

OUT = Path("runs/tune")


def settings(trial: "Trial | FixedTrial") -> TrainConfig:
    """Return settings of the imitation stage, some of them chosen by Optuna; change the
    search space here."""
    config = bp2.preset("imitation", "cpu")
    reward = dataclasses.replace(
        config.env.reward, tracking=trial.suggest_float("tracking", 0.5, 3.0)
    )
    ppo = dataclasses.replace(
        config.ppo,
        learning_rate=trial.suggest_float("learning_rate", 1e-4, 1e-3, log=True),
        entropy_cost=trial.suggest_float("entropy_cost", 5e-4, 1e-2, log=True),
    )
    # No judge during the training: `top_speed` measures all saved policies in the same
    # way.
    run = dataclasses.replace(config.run, judged=0)
    env = dataclasses.replace(config.env, reward=reward)
    return dataclasses.replace(config, env=env, ppo=ppo, run=run)


def top_speed(config: TrainConfig, folder: Path) -> float:
    """Train a run; return the speed of its fastest policy in C MuJoCo, m/s, 0 if all
    fall."""
    bp2.train(config, folder)
    return max(policy.top_speed for policy in measure_policies(folder))


def search(
    executor: "Executor | submitit.Executor", trials: int, at_once: int = 1
) -> "FrozenTrial":
    """Run further trials; return the best of all trials."""
    import optuna

    OUT.mkdir(parents=True, exist_ok=True)
    study = optuna.create_study(
        storage=f"sqlite:///{OUT.resolve()}/tune.db",
        study_name="bp2",
        load_if_exists=True,
        direction="maximize",
    )
    for _ in range(0, trials, at_once):
        asked = [study.ask() for _ in range(at_once)]
        jobs = [
            executor.submit(top_speed, settings(one), OUT / f"trial-{one.number}")
            for one in asked
        ]
        for trial, job in zip(asked, jobs, strict=True):
            study.tell(trial, job.result())
    return study.best_trial


def main() -> None:
    """Search on this machine, or with submitit's executor that the argument names:
    `slurm`, or `local` to test it."""
    if sys.argv[1:]:
        import submitit

        cluster = submitit.AutoExecutor(OUT / "jobs", cluster=sys.argv[1])
        cluster.update_parameters(timeout_min=240, gpus_per_node=1, cpus_per_task=8)
        best = search(cluster, trials=100, at_once=10)
    else:
        # A training needs a separate Python process, in which it uses all processors.
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(1, spawn, max_tasks_per_child=1) as here:
            best = search(here, trials=20)
    print(f"{best.value:.2f} m/s with {best.params}; check it over seeds")


if __name__ == "__main__":
    main()
