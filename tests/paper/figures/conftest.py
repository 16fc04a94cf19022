import pytest

from bp2_rl.base.serialization import save_config
from bp2_rl.evaluation.report.folder import TRAJECTORY, Report


@pytest.fixture
def leave_report(tmp_path):
    """Leave a run's report in a folder, and return it."""

    def leave(
        run,
        benchmark="topspeed",
        name="report",
        robot="ideal: none",
        results=None,
        **more,
    ):
        folder = tmp_path / name
        folder.mkdir()
        report = Report(benchmark, {"robot": robot, **more}, results or {})
        save_config(folder / "metrics.json", report)
        run.save(folder / TRAJECTORY)
        return folder

    return leave
