"""The report in a real browser: from disk, without a network, on a desk, a phone and paper."""

import base64
import json
import re
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from report_runs import discovered, explained, hostile_run, unexplained

from eoi_jax.report.svg import variables

BROWSERS = ("chromium", "chromium-browser", "google-chrome")
FLAGS = (
    "--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run",
    "--disable-background-networking", "--disable-component-update", "--disable-sync",
)  # fmt: skip
DESK, PHONE = 1200, 360


@pytest.fixture(scope="module")
def browser(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Any]:
    webdriver = pytest.importorskip("selenium.webdriver", reason="selenium is not installed")
    service = pytest.importorskip("selenium.webdriver.chrome.service")
    program = next(filter(None, map(shutil.which, BROWSERS)), None)
    driver = shutil.which("chromedriver")
    if program is None or driver is None:
        pytest.skip("the report is not looked at: chromium or chromedriver is not installed")
    options = webdriver.ChromeOptions()
    options.binary_location = program
    for flag in (*FLAGS, f"--user-data-dir={tmp_path_factory.mktemp('profile')}"):
        options.add_argument(flag)
    options.set_capability("goog:loggingPrefs", {"browser": "ALL", "performance": "ALL"})
    started = webdriver.Chrome(options=options, service=service.Service(driver))
    started.execute_cdp_cmd("Network.enable", {})
    none = {"offline": True, "latency": 0, "downloadThroughput": 0, "uploadThroughput": 0}
    started.execute_cdp_cmd("Network.emulateNetworkConditions", none)
    yield started
    started.quit()


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    root = tmp_path_factory.mktemp("runs")
    found = explained()
    return {
        "explained": discovered(root / "explained", found),
        "unexplained": discovered(root / "unexplained", unexplained(found)),
        "hostile": hostile_run(root / "hostile"),
    }


@pytest.fixture(params=["explained", "unexplained", "hostile"])
def any_run(request, folders: dict[str, Path]) -> Path:
    return folders[request.param]


def look(browser: Any, folder: Path, width: int = DESK, theme: str = "light") -> None:
    size = {"width": width, "height": 800, "deviceScaleFactor": 1, "mobile": False}
    browser.execute_cdp_cmd("Emulation.setDeviceMetricsOverride", size)
    scheme = [{"name": "prefers-color-scheme", "value": theme}]
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"features": scheme})
    browser.get_log("browser")  # what others left there
    browser.get_log("performance")
    browser.get((folder / "report.html").as_uri())


def ask(browser: Any, expression: str) -> Any:
    return browser.execute_script(f"return {expression}")


def test_it_opens_from_disk_without_a_network_an_error_or_a_request(browser, any_run):
    look(browser, any_run)
    assert browser.get_log("browser") == []
    asked = [
        message["params"]["request"]["url"]
        for entry in browser.get_log("performance")
        if (message := json.loads(entry["message"])["message"])["method"]
        == "Network.requestWillBeSent"
    ]
    assert asked
    assert {url.split(":")[0] for url in asked} <= {"file", "data"}
    assert (any_run / "report.html").stat().st_size < 5e6


@pytest.mark.parametrize("width", [DESK, PHONE])
def test_every_figure_is_seen_within_the_page(browser, any_run, width):
    look(browser, any_run, width)
    boxes = ask(browser, "[...document.querySelectorAll('figure svg')].map(one => { const box = "
                "one.getBoundingClientRect(); return [box.left, box.right, box.width, box.height, "
                "one.querySelectorAll('path').length]; })")  # fmt: skip
    assert len(boxes) >= 6
    for left, right, across, high, paths in boxes:
        assert left >= 0
        assert right <= width
        assert across > 250
        assert high > 100
        assert paths > 10
    sizes = ask(
        browser,
        "[...document.querySelectorAll('figure svg text')].map(one => { const to = one.getScreenCTM"
        "(); return parseFloat(getComputedStyle(one).fontSize) * Math.hypot(to.a, to.b); })",
    )
    assert min(sizes) > (5.5 if width == PHONE else 8)  # [px]


@pytest.mark.parametrize("width", [DESK, PHONE])
def test_nothing_makes_the_page_scroll_sideways(browser, any_run, width):
    look(browser, any_run, width)
    assert ask(browser, "document.documentElement.scrollWidth") <= width
    out = ask(
        browser,
        "[...document.querySelectorAll('h1, h2, p, dd, li, figcaption, summary')].filter("
        "one => one.scrollWidth > one.clientWidth + 1).map(one => one.outerHTML)",
    )
    assert out == []


def test_the_answer_comes_first_and_what_was_added_is_marked_in_the_equation(browser, folders):
    look(browser, folders["explained"])
    summary = json.loads((folders["explained"] / "discovery.json").read_text())
    shown = ask(browser, "document.querySelector('h1').textContent")
    assert shown.replace("\u00a0", " ") == summary["answer"]
    added = ask(browser, "[...document.querySelectorAll('math .added')].map(one => [one.textContent"
                ", one.getBoundingClientRect().width, getComputedStyle(one).color])")  # fmt: skip
    assert len(added) == 2 * len(summary["added"])  # with names, and with values
    assert "coulomb_friction" in added[0][0]
    plain = ask(browser, "getComputedStyle(document.querySelector('math mtd')).color")
    assert all(width > 20 and colour != plain for _, width, colour in added)


def test_a_click_on_a_head_sorts_by_numbers_and_a_second_one_turns_it_round(browser, folders):
    look(browser, folders["explained"])
    column = "[...document.querySelectorAll('table')][0]"
    cells = f"[...{column}.tBodies[0].rows].map(row => row.cells[4].textContent)"
    for direction in ("ascending", "descending"):
        browser.execute_script(f"{column}.querySelectorAll('th button')[4].click()")
        values = [float(one) for one in ask(browser, cells)]
        assert values == sorted(values, reverse=direction == "descending")
        assert ask(browser, f"{column}.querySelectorAll('th')[4].ariaSort") == direction
    assert ask(browser, f"{column}.querySelectorAll('th[aria-sort=none]').length") == 6
    # From the keyboard: a head is a button.
    browser.execute_script(f"{column}.querySelector('th button').focus()")
    browser.switch_to.active_element.send_keys("\n")
    names = ask(browser, f"[...{column}.tBodies[0].rows].map(row => row.cells[0].textContent)")
    assert names == sorted(names)


def test_it_is_dark_where_the_reader_likes_it_dark_figures_too(browser, folders):
    seen = {}
    for theme in ("light", "dark"):
        look(browser, folders["explained"], theme=theme)
        seen[theme] = ask(
            browser,
            "[getComputedStyle(document.documentElement).backgroundColor, getComputedStyle("
            "document.querySelector('#freerun-line2d_2, #residual svg [style*=\"--s0\"]')).stroke]",
        )
        wanted = variables(theme == "dark")
        assert seen[theme] == [rgb(wanted["--page"]), rgb(wanted["--s0"])]
    assert seen["light"] != seen["dark"]


def rgb(colour: str) -> str:
    parts = (int(colour[i : i + 2], 16) for i in (1, 3, 5))
    return f"rgb({', '.join(map(str, parts))})"


def test_it_prints_on_pages_of_a4_with_its_configuration(browser, folders):
    look(browser, folders["explained"], theme="dark")
    options = {"preferCSSPageSize": True, "printBackground": True}
    printed = base64.b64decode(browser.execute_cdp_cmd("Page.printToPDF", options)["data"])
    assert printed.startswith(b"%PDF")
    pages = printed.count(b"/Type /Page\n")
    assert 2 <= pages <= 8
    boxes = re.findall(rb"/MediaBox \[0 0 ([\d.]+) ([\d.]+)\]", printed)
    a4 = [210 / 25.4 * 72, 297 / 25.4 * 72]  # [pt]
    assert boxes
    assert all([float(one) for one in box] == pytest.approx(a4, abs=1.0) for box in boxes)
    assert ask(browser, "document.querySelector('details').open")
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": "print", "features": [
        {"name": "prefers-color-scheme", "value": "dark"}]})  # fmt: skip
    light = rgb(variables(dark=False)["--page"])
    assert ask(browser, "getComputedStyle(document.documentElement).backgroundColor") == light
    browser.execute_cdp_cmd("Emulation.setEmulatedMedia", {"media": ""})


def test_names_and_units_are_text_whatever_they_hold(browser, folders):
    look(browser, folders["hostile"])
    time.sleep(0.2)  # an image that fails to load says so a little later
    assert ask(browser, "typeof hacked") == "undefined"
    assert ask(browser, "document.scripts.length") == 1
    assert ask(browser, "document.querySelectorAll('img').length") == 0
    text = ask(browser, "document.body.textContent")
    for number in (1, 3, 4, 5, 6):
        assert f"<script>hacked={number}</script>" in text.replace("\u00a0", " ")
    assert '"><img src=x onerror="hacked=2">' in text.replace("\u00a0", " ")


def test_a_script_that_got_in_would_not_run(browser, folders, tmp_path):
    page = (folders["explained"] / "report.html").read_text()
    bad = "<script>hacked=1</script><img src=x onerror='hacked=1'><p onclick='hacked=1'>x</p>"
    (tmp_path / "report.html").write_text(page.replace("<main>", f"<main>{bad}"))
    look(browser, tmp_path)
    time.sleep(0.2)
    assert ask(browser, "typeof hacked") == "undefined"
    assert any("Content Security Policy" in one["message"] for one in browser.get_log("browser"))
