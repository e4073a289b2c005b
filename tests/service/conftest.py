"""What tests of the daemon share."""

import pytest

from support.coroutines import pytest_pyfunc_call as pytest_pyfunc_call


@pytest.fixture
def path(tmp_path):
    """Of the control socket."""
    return tmp_path / "control.sock"
