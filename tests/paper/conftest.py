import pytest
from coarse import coarse_trot

from bp2_rl.base.serialization import from_json, to_json


@pytest.fixture(scope="session")
def trot():
    return coarse_trot()


@pytest.fixture
def assert_report(assert_fits):
    """Require that an evaluation's rows, tiles, tables and metrics make a whole
    report."""

    def assert_report(evaluation):
        labels = [row.label for row in evaluation.rows]
        assert len(set(labels)) == len(labels)
        assert set(evaluation.tiles) <= set(labels) or not evaluation.good
        for table in evaluation.tables:
            assert all(len(line) == len(table.head) for line in table.lines)
        metrics = evaluation.metrics
        assert from_json(type(metrics), to_json(metrics)) == metrics
        assert_fits(evaluation)

    return assert_report
