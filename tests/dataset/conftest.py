"""What the dataset tests share."""

from __future__ import annotations

import pytest


@pytest.fixture(scope="session")
def is_long(request: pytest.FixtureRequest) -> bool:
    """Whether --long asks for the full number of rays and points."""
    return bool(request.config.getoption("--long"))
