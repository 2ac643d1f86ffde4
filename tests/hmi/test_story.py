"""The whole story of an operator in a browser: campaign, audit, model, report, controller, drive."""

import json
import time

import pytest
from operated import Operator, served

pytestmark = pytest.mark.long

LONGEST_S = 900  # s that one command may take on a machine with other tests beside it
BRIEFEST = """
[lifting]
structure = "integrator-first-order"

[lowering]
structure = "integrator-first-order"

[search]
evaluations = 300
compare = false

[training]
epochs = 3
free_run = false
baselines = false
"""


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Return a project folder with the settings of the briefest identification."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "brief.toml").write_text(BRIEFEST)
    return folder


@pytest.fixture(scope="module")
def operator(browser, project):
    """Return an operator before a fresh page; at the end nothing was asked of any other machine."""
    with served(project, "--silence-ms", "5000") as (link, _):
        page = browser.new_page(viewport={"width": 1280, "height": 800})
        operator = Operator(page, link)
        operator.wait_for_state("no source")
        yield operator
        assert operator.outside == []
        assert operator.messages == []


def finished(operator, kind):
    """Wait until the newest command of a kind has ended well."""
    operator.page.wait_for_function(
        "kind => window.hitchid.jobs.some(job => job.kind === kind && job.state !== 'running')",
        arg=kind,
        timeout=1000 * LONGEST_S,
    )
    job = operator.page.evaluate("kind => window.hitchid.jobs.findLast(job => job.kind === kind)", kind)
    assert job["state"] == "done", "\n".join(job["lines"])
    return job


def last_displacement(log):
    """Return the last displacement of a log that is being written, mm."""
    lines = log.read_text().splitlines()
    return float(lines[-1].split(",")[3]) if len(lines) > 1 else float("nan")


def wait_until(holds):
    """Wait until something holds."""
    end_s = time.monotonic() + LONGEST_S
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.1)


def test_from_the_bench_to_a_driven_hitch(operator, project):
    operator.connect(speed=20)
    operator.tab_campaign.click()
    operator.fill_plan(name="monday", ramps=1, ramp_s=8, tests=3, test_s=5)
    operator.plan_unattended.check()
    operator.run()
    operator.wait_for_state("idle", LONGEST_S)
    logs = sorted(path.name for path in (project / "campaigns" / "monday").glob("*.csv"))
    assert len(logs) == 8

    finished(operator, "inspect")
    operator.tab_identify.click()
    operator.identify_logs.select_option("campaigns/monday")
    operator.identify_name.fill("first")
    operator.identify_brief.check()
    operator.identify_start.click()
    job = finished(operator, "identify")
    assert any("searching parameters" in name for name in job["curves"])
    operator.validate_name.fill("first")
    operator.validate_start.click()
    finished(operator, "validate")
    report = operator.page.frame_locator("[data-testid=report-frame]")
    report.get_by_role("heading").first.wait_for()

    operator.tab_drive.click()
    operator.tune_name.fill("first")
    operator.tune_start.click()
    finished(operator, "tune")
    operator.drive_name.fill("evening")
    operator.drive_arm.click()
    operator.wait_for_state("armed", LONGEST_S)
    operator.drive_start.click()
    operator.wait_for_state("running")
    operator.target_number.fill("60")
    operator.target_number.press("Enter")
    wait_until(lambda: abs(last_displacement(project / "drives" / "evening.csv") - 60) < 2)
    operator.page.keyboard.press("Escape")
    operator.wait_for_state("stopped")
    operator.reset.click()
    operator.wait_for_state("idle")
    assert (project / "drives" / "evening.csv").stat().st_size > 10_000
    events = [json.loads(line)["event"] for line in (project / "hmi.log").read_text().splitlines()]
    assert events == ["claim", "connect", "arm", "start", "arm", "start", "stop", "stopped", "reset"]


def test_campaign_chooses_its_own_tests_is_stopped_and_goes_on(browser, tmp_path):
    campaign = tmp_path / "campaigns" / "chosen"
    with served(tmp_path, "--silence-ms", "5000") as (link, _):
        operator = Operator(browser.new_page(viewport={"width": 1280, "height": 800}), link)
        operator.wait_for_state("no source")
        operator.connect(speed=20)
        operator.tab_campaign.click()
        operator.plan_kind.select_option("adaptive")
        operator.fill_plan(name="chosen", minutes=1.6, goal="free run 0.2 kg in 10 s")
        assert operator.plan_minutes.is_visible()
        assert not operator.plan_ramps.is_visible()
        operator.fill_plan(goal="")
        operator.run()
        # What it does next and why, in one line.
        wait_until(lambda: "the first test of this direction" in operator.run_why.inner_text())
        operator.page.screenshot(path=tmp_path / "page.png")
        operator.page.keyboard.press("Escape")
        operator.wait_for_state("stopped")
        before = sorted(campaign.glob("*.csv"))
        operator.reset.click()
        operator.wait_for_state("idle")
        operator.fill_plan(name="chosen")
        operator.plan_resume.check()
        operator.run()
        operator.wait_for_state("idle", LONGEST_S)
        assert set(before) < set(campaign.glob("*.csv"))
        wait_until((tmp_path / "reports" / "chosen" / "report.html").exists)
        assert operator.messages == []
