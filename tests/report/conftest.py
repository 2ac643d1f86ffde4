"""What the tests of pages share: one browser."""

import pytest

from browser import chromium


@pytest.fixture(scope="session")
def browser():
    """Return Chromium, or skip what needs it."""
    with chromium() as driven:
        yield driven
