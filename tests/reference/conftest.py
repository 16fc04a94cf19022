import jax
import pytest


@pytest.fixture(scope="module")
def double_precision():
    """Numerical differentiation needs it."""
    with jax.enable_x64(True):
        yield
