"""A page of a running server, as an operator has it."""

import os
import re
import subprocess
import sys
import time
import urllib.parse
from contextlib import contextmanager


@contextmanager
def served(project, *options):
    """Yield the link and the process of a server of a project folder."""
    command = [sys.executable, "-m", "hitchid", "hmi", str(project), "--quiet", *options]
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, sys.path))}  # for `fake_bench`
    process = subprocess.Popen(  # noqa: S603 - this Python, the command under test
        command, stdout=subprocess.PIPE, text=True, cwd=project, env=environment
    )
    try:
        yield process.stdout.readline().strip(), process
    finally:
        process.terminate()
        try:
            process.wait(20)
        except subprocess.TimeoutExpired:
            process.kill()
            raise


class Operator:
    """What an operator does with a page, and what the page has asked for and said.

    Args:
        page: of the browser.
        link: that opens it.
    """

    def __init__(self, page, link):
        self.page, self.requests, self.messages = page, [], []
        page.on("request", lambda request: self.requests.append(request.url))
        page.on("console", lambda message: self.messages.append(message.text))
        page.on("pageerror", lambda error: self.messages.append(str(error)))
        page.goto(link)
        self.origin = "{0.scheme}://{0.netloc}".format(urllib.parse.urlsplit(link))

    def __getattr__(self, name):
        """Return the control of a name: `plan_name` for `plan-name`."""
        return self.page.get_by_test_id(name.replace("_", "-"))

    def wait_for_state(self, state, seconds=30):
        """Wait until the page shows a state."""
        shown = self.page.get_by_test_id("state")
        end_s = time.monotonic() + seconds
        while state not in (text := shown.inner_text().lower()):
            assert time.monotonic() < end_s, text
            self.page.wait_for_timeout(50)

    def connect(self, speed=10):
        """Connect the virtual bench."""
        self.source.select_option("rig")
        self.option_speed.select_option(str(speed))
        self.page.get_by_test_id("connect").click()
        self.wait_for_state("idle", 60)

    def fill_plan(self, **fields):
        """Fill the fields of a campaign's plan."""
        for field, value in fields.items():
            self.page.get_by_test_id(f"plan-{field}").fill(str(value))

    def run(self):
        """Arm and start the plan that is shown."""
        self.arm.click()
        self.wait_for_state("armed")
        self.start.click()
        self.wait_for_state("running")

    @property
    def outside(self):
        """Requests to anything but the server."""
        allowed = (self.origin, self.origin.replace("http", "ws", 1), "data:")
        return [url for url in self.requests if not url.startswith(allowed)]


def process_time_s(number):
    """Return the processor time of a process, s."""
    with open(f"/proc/{number}/stat") as file:
        fields = re.sub(r"\(.*\)", "", file.read()).split()
    return sum(map(int, fields[12:14])) / os.sysconf("SC_CLK_TCK")


def resident_mb(number):
    """Return the memory of a process, MB."""
    with open(f"/proc/{number}/statm") as file:
        return int(file.read().split()[1]) * os.sysconf("SC_PAGE_SIZE") / 1e6
