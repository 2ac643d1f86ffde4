"""The interactive page: its data are those of the tests, nothing in it runs but its own script."""

import base64
import hashlib
import json
import re
from dataclasses import replace

import numpy as np
import pytest

import validated
from hitchid.report import Document, render
from hitchid.report.document import Signals
from test_page import read


def page(signals):
    return render(Document("Validation", signals=signals), "interactive").decode()


def signals_of(tests):
    return Signals({"lifting": tests}, "mm", {"lifting_command": "A"})


@pytest.fixture(scope="module")
def text():
    return page(signals_of(validated.predictions()))


def data(text):
    (script,) = re.findall(r'<script type="application/json" id="data">(.*?)</script>', text, re.DOTALL)
    return json.loads(script)


def decoded(values):
    return np.frombuffer(base64.b64decode(values), dtype="<f4")


def test_the_page_holds_every_sample_in_single_precision(text):
    tests, content = validated.predictions(), data(text)
    assert content["unit"] == "mm"
    held = content["sections"]["lifting"]
    assert [test["name"] for test in held] == list(tests.names)
    for index, test in enumerate(held):
        (command,) = test["commands"]
        pairs = [(test["time"], tests.time_s), (test["measured"], tests.actual)]
        pairs += [(end, rows) for end, rows in zip(test["band"], tests.band, strict=True)]
        pairs += [(model["values"], tests.models[model["key"]]) for model in test["models"]]
        pairs += [(command["values"], tests.commands["lifting_command"])]
        for values, rows in pairs:
            # Half a unit in the last of 24 binary digits.
            np.testing.assert_allclose(decoded(values), rows[index], rtol=2.0**-24)
        assert {model["key"] for model in test["models"]} == set(tests.models)
        assert command["label"] == "lifting command / A"


def test_two_compared_models_are_drawn_as_two_lines():
    tests = validated.predictions()
    compared = dict(zip("AB", tests.models.values(), strict=False))
    (test, *_) = data(page(signals_of(replace(tests, models=compared))))["sections"]["lifting"]
    assert [model["key"] for model in test["models"]] == ["A", "B"]
    assert len({(model["colour"], *model["dash"]) for model in test["models"]}) == 2


def test_the_policy_permits_the_pages_own_script_and_style_alone(text):
    (policy,) = re.findall(r'Content-Security-Policy" content="([^"]+)"', text)
    (style,), (script,) = (
        re.findall(rf"<{tag}>(.*?)</{tag}>", text, re.DOTALL) for tag in ("style", "script")
    )
    for kind, content in (("style", style), ("script", script)):
        checksum = base64.b64encode(hashlib.sha256(content.encode()).digest()).decode()
        assert f"{kind}-src 'sha256-{checksum}'" in policy.replace("&#39;", "'")
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy


def test_a_page_asks_for_nothing(text):
    addresses = set(re.findall(r"https?://[^\s\"')]+", text))
    assert addresses == {"http://www.w3.org/2000/svg"}  # the name of SVG, which nothing fetches
    for element in read(text).all():
        assert not [name for name in element.attributes if name.startswith("on")]
        assert element.get("src") is None
        assert element.get("href") in (None, "data:,")


def test_what_diverged_stays_what_it_is():
    tests = validated.predictions((20, 30))
    wild = tests.take([0, 1])
    wild.models["free_run"][0][5:] = np.inf
    wild.models["free_run"][1][5:] = 1e300
    held = data(page(signals_of(wild)))["sections"]["lifting"]
    for test in held:
        (values,) = (decoded(m["values"]) for m in test["models"] if m["key"] == "free_run")
        assert np.isinf(values[5:]).all()
        assert np.isfinite(values[:5]).all()


def test_equal_documents_give_equal_bytes_and_none_a_page(text):
    assert page(signals_of(validated.predictions())) == text
    assert data(page(None)) == {}
