import pytest
from coarse import coarse_trot


@pytest.fixture(scope="session")
def trot():
    return coarse_trot()
