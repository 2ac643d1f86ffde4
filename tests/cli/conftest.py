"""What the tests of the command line share."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def cache_folder(tmp_path_factory):
    """Keep finished searches out of the user's cache."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_CACHE_HOME", str(tmp_path_factory.mktemp("cache")))
        yield
