"""A fleet that was identified, once for all files of a run; no test changes it."""

import fleets
import pytest

from hitchid.fleet import Runner, identify_fleet, random_effects


@pytest.fixture
def without_weights(monkeypatch):
    """Let no machine lose weight: then the statistics have closed forms."""
    monkeypatch.setattr(random_effects, "normal_constants", lambda parameters=1: random_effects.PLAIN)


@pytest.fixture(scope="session")
def _identified_fleet(once):
    def identify(folder):
        logs = fleets.write_fleet(folder / "logs", fleets.MACHINES)
        result = identify_fleet(
            str(logs), str(folder / "results"), settings=fleets.QUICK, runner=Runner(workers=1)
        )
        assert result.worked == fleets.MACHINES

    return once("fleet", identify)


@pytest.fixture(scope="session")
def logs(_identified_fleet):
    """Return a store with logs of some machines."""
    return _identified_fleet / "logs"


@pytest.fixture(scope="session")
def results(_identified_fleet):
    """Return a store of their results by one worker."""
    return _identified_fleet / "results"
