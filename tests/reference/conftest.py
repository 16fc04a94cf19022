import jax
import pytest


@pytest.fixture(scope="module")
def double_precision():
    """Compute in double precision, which numerical differentiation needs."""
    with jax.enable_x64(True):
        yield
