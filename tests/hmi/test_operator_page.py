"""The page in a browser: small and large, light and dark, by keyboard, with viewers, closed and frozen."""

import csv
import math
import time
from importlib.util import find_spec
from pathlib import Path

import pytest
from operated import Operator, served

import handmade
import hitchid
from fake_bench import LIMITS_FILE
from hitchid.live import Changes, Event, read_events
from hitchid.model import save

pytestmark = pytest.mark.long

HOLD = "time_s,lifting_command,lowering_command\n0,0.4,0\n30,0.4,0\n"
SIZES = ((390, 844), (1280, 800), (1920, 1080))
LONGEST_S = 100  # s for the start of the adaptation on a machine with other tests beside it
SECTIONS = ("bench", "campaign", "identify", "drive", "project")


@pytest.fixture(scope="module")
def project(tmp_path_factory):
    """Return a project folder with limits and a test of slow lifting."""
    folder = tmp_path_factory.mktemp("project")
    (folder / "limits.toml").write_text(LIMITS_FILE)
    (folder / "uploads").mkdir()
    (folder / "uploads" / "hold.csv").write_text(HOLD)
    save(handmade.hitch(), folder / "models" / "hand")
    (folder / "changes").mkdir()
    changes = Changes(gain=math.log(1.1), dead_zone=0.02)
    learned = [Event(kind, 60.0, 9, "lifting", "", changes) for kind in ("promoted", "moved")]
    (folder / "changes" / "hand.jsonl").write_text("".join(f"{event.to_json()}\n" for event in learned))
    return folder


@pytest.fixture(scope="module")
def operator(browser, project):
    """Return an operator whose page shows a bench in plain Python."""
    options = ("--source", "fake_bench:Plant", "--limits", "limits.toml")
    with served(project, *options) as (link, _):
        operator = Operator(
            browser.new_page(viewport={"width": 1280, "height": 800}, reduced_motion="reduce"), link
        )
        operator.wait_for_state("no source")
        operator.page.get_by_test_id("connect").click()
        operator.wait_for_state("idle")
        yield operator


@pytest.fixture
def name(request):
    """Return a name that no other test uses."""
    return f"{abs(hash(request.node.name)) % 10**8}"


def start_hold(operator, name):
    """Start slow lifting from a file."""
    operator.tab_campaign.click()
    operator.plan_kind.select_option("file")
    operator.fill_plan(name=name)
    operator.plan_file.select_option("uploads/hold.csv")
    operator.run()


def times_s(log):
    """Return the times of a log, s."""
    with log.open() as file:
        return [float(row["time_s"]) for row in csv.DictReader(file)]


def serious_findings(page):
    """Return what axe finds of serious and critical problems of accessibility, or skip what needs it."""
    if find_spec("axe_playwright_python") is None:
        pytest.skip("axe-playwright-python is not installed; it judges accessibility")
    from axe_playwright_python import sync_playwright as axe

    page.evaluate((Path(axe.__file__).parent / "axe.min.js").read_text())
    findings = page.evaluate(
        "async () => (await axe.run()).violations.map(v => [v.impact, v.id, ...v.nodes.map(n => n.html)])"
    )
    return [finding for finding in findings if finding[0] in ("serious", "critical")]


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_section_fits_and_is_accessible(operator, scheme):
    page = operator.page
    page.emulate_media(color_scheme=scheme)
    for section in SECTIONS:
        getattr(operator, f"tab_{section}").click()
        for width, height in SIZES:
            page.set_viewport_size({"width": width, "height": height})
            assert page.evaluate("document.documentElement.scrollWidth") <= width, (section, width)
        assert serious_findings(page) == [], section
    page.set_viewport_size({"width": 1280, "height": 800})


def test_an_adapted_model_is_saved_and_rolled_back_by_keyboard(operator, project):
    page = operator.page
    operator.tab_bench.click()
    operator.monitor_model.select_option("models/hand")
    page.locator("[data-testid=adapt]:enabled").focus()  # which it is once the model has been chosen
    page.keyboard.press("Space")
    row = page.locator("#adapt-changes [data-direction=lifting]")
    row.get_by_text("+10.0 %").wait_for(timeout=3000 * LONGEST_S)  # a process that compiles
    row.get_by_text("+0.020 A").wait_for()
    assert operator.roll_back_lowering.is_disabled()
    operator.roll_back_lifting.focus()
    page.keyboard.press("Enter")
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        assert serious_findings(page) == []
    operator.save_adapted.click()
    page.get_by_text("Saved as models/hand-adapted").wait_for()
    operator.save_name.fill("hand-adapted")
    operator.save_adapted.click()
    problem = operator.problem.filter(has_text="models/hand-adapted: exists already; choose another name")
    problem.get_by_role("button").click()
    assert page.evaluate("document.activeElement.dataset.testid") != "adapt-back"
    operator.adapt_back.focus()
    page.keyboard.press("Enter")
    page.get_by_text("Rolled back").wait_for()
    row.get_by_text("0.0 %", exact=True).wait_for()
    assert operator.roll_back_lifting.is_disabled()
    operator.adapt.focus()
    page.keyboard.press("Space")
    page.get_by_text("Off: the model is used as identified").wait_for()
    assert [event.kind for event in read_events(project / "changes" / "hand.jsonl")][-1] == "rolled back"
    gain = hitchid.load(project / "models" / "hand-adapted").channels["lifting"].benchmark.parameter_vector[0]
    assert float(gain) == pytest.approx(1.1 * handmade.GAINS["lifting"])
    operator.monitor_model.select_option("")


def test_a_test_is_armed_started_and_stopped_by_keyboard_alone(operator, name):
    page = operator.page

    def reach(control):
        """Press Tab until a control has the focus."""
        for _ in range(80):
            if page.evaluate("document.activeElement?.dataset?.testid") == control:
                return
            page.keyboard.press("Tab")
        pytest.fail(f"{control} is not reached by Tab")

    page.evaluate("document.activeElement?.blur()")
    reach("tab-campaign")
    page.keyboard.press("Enter")
    reach("plan-kind")
    page.keyboard.press("C")  # the plan whose name begins so: commands from a file
    reach("plan-name")
    page.keyboard.press("Control+A")
    page.keyboard.type(name)
    reach("arm")
    page.keyboard.press("Enter")
    operator.wait_for_state("armed")
    reach("start")
    page.keyboard.press("Enter")
    operator.wait_for_state("running")
    reach("stop")
    page.keyboard.press("Escape")
    operator.wait_for_state("stopped by the operator")
    reach("reset")
    page.keyboard.press("Enter")
    operator.wait_for_state("idle")


def test_a_viewer_sees_all_may_stop_and_may_not_start(operator, browser, name):
    link = operator.page.evaluate(
        "async () => (await (await fetch('/api/link', { method: 'POST' })).json()).link"
    )
    viewer = Operator(browser.new_page(), link)
    viewer.wait_for_state("idle")
    start_hold(operator, name)
    viewer.wait_for_state("running")
    refusal = viewer.page.evaluate("window.hitchid.connection.send('reset').catch((error) => error.message)")
    assert refusal == "this page only watches; become the operator first"
    viewer.stop.click()
    operator.wait_for_state("stopped by a viewer")
    operator.reset.click()
    viewer.page.close()


def test_a_frozen_page_stops_the_machine_and_loses_no_sample(operator, project, name):
    start_hold(operator, name)
    operator.page.evaluate("const end = Date.now() + 1500; while (Date.now() < end);")
    operator.wait_for_state("the operator's page gave no sign of life")
    operator.reset.click()
    operator.wait_for_state("idle")
    times = times_s(project / "campaigns" / name / f"{name}.csv")
    assert [round(100 * time_s) for time_s in times] == list(range(len(times)))
    assert times[-1] < 3


def test_an_unattended_campaign_goes_on_while_the_page_is_away(operator, project, name):
    operator.tab_campaign.click()
    operator.plan_kind.select_option("campaign")
    operator.fill_plan(name=name, ramps=1, ramp_s=2, tests=0)
    operator.page.get_by_test_id("plan-directions").select_option(index=1)
    operator.plan_unattended.check()
    operator.run()
    operator.page.goto("about:blank")
    log = project / "campaigns" / name / "ramp-lifting-01.csv"
    end_s = time.monotonic() + 40
    while not log.exists() or len(log.read_text().splitlines()) < 50:
        assert time.monotonic() < end_s
        time.sleep(0.2)
    operator.page.goto(operator.origin)
    operator.wait_for_state("idle", 40)
    times = times_s(log)
    assert [round(100 * time_s) for time_s in times] == list(range(len(times)))
