"""Options that all tests share."""

from __future__ import annotations

import pytest
from hypothesis import settings

settings.register_profile("busy machine", deadline=None)  # how long an example takes says nothing there
settings.load_profile("busy machine")


def pytest_addoption(parser: pytest.Parser) -> None:
    group = parser.getgroup("golden pictures")
    group.addoption("--regenerate-golden", action="store_true", help="rewrite tests/golden from what is rendered now")
    group.addoption(
        "--require-golden",
        action="store_true",
        help="fail where golden pictures or real data cannot be compared, instead of skipping; always on where CI is set",
    )
